//! Trajectory logs: what actors did, step by step, as MCAP files that Foxglove plays, Python reads and the simulator
//! can repeat.
//!
//! A log consists of shares: what one lease computed of one episode. The stepping thread only collects (`witness.rs`)
//! and hands whole leases to a thread of its own (`scribe.rs`), which cuts them into shares (`cut.rs`) and writes
//! them (`file.rs`). That thread may lose shares, which it counts, but never holds the stepping thread up. The other
//! files read logs, all of them through `records.rs`, which trusts nothing.

mod config;
mod cut;
mod error;
mod file;
mod index;
mod join;
mod records;
mod recover;
mod replay;
mod rewards;
mod scribe;
mod shares;
mod source;
mod survey;
#[cfg(test)]
pub(crate) mod tests;
mod witness;

pub use config::{LogConfig, LogSettings};
pub use error::LogError;
pub use index::{EpisodeId, Index};
pub use join::{Joined, join};
pub use recover::{Loss, Recovered, recover};
pub use replay::{Difference, Replayed, replay};
pub use shares::{LoggedShare, LoggedStep, ReadShares, read_shares};
pub use source::{is_log_name, read_bytes};
pub use survey::{Survey, Topic, survey, totals};

pub(crate) use scribe::{Desk, Log};

/// Name of the metadata record that tells which run, task and actor a log is of.
pub const METADATA_NAME: &str = "s2mia.log";
/// Name of the metadata record that tells, at a log's end, what it holds and what was lost on the way to it.
pub const TOTALS_NAME: &str = "s2mia.log.totals";
/// Name of the attachment with the task's settings.
const TASK_NAME: &str = "task.json";
/// Name of the attachment with the run's resolved settings.
const SETTINGS_NAME: &str = "config.toml";
