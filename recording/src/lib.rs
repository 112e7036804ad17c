//! Records what environments do: trajectory logs and recordings as MCAP files.
//!
//! Both have the same topics (`channels.rs`), written to an MCAP file (`mcap_file.rs`). Episodes come from the crate
//! [`rollout`]. [`trajectory_log`] also has the tools that read logs.

mod channels;
mod error;
mod mcap_file;
mod record;
mod share;
pub mod trajectory_log;

pub use error::RecordError;
pub use record::{RecordSummary, RecordedRun, record};
pub use share::{LoggedShare, LoggedStep};
