//! Records what environments do: trajectory logs and recordings as MCAP files, and a live view over WebSocket.
//!
//! All of them have the same topics (`channels.rs`), written to a sink (`sink.rs`): an MCAP file (`mcap_file.rs`) or the
//! viewers of a live view (`live/sink.rs`). Episodes come from the crate [`rollout`]. [`trajectory_log`] also has the
//! tools that read logs.

mod channels;
mod error;
mod live;
mod mcap_file;
mod record;
mod share;
mod sink;
mod step_reader;
pub mod trajectory_log;

pub use error::RecordError;
pub use live::{LiveError, LiveScene, LiveServer, LiveTopic};
pub use record::{RecordSummary, RecordedRun, record};
pub use share::{LoggedShare, LoggedStep};
