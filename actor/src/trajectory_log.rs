//! Trajectory logs: the steps of actors as MCAP files, for Foxglove, Python and replay in the simulator.
//!
//! A log consists of shares: the steps of one episode in one lease. The stepping thread only collects data
//! (`collector.rs`) and sends whole leases to the log-writer thread (`writer.rs`), which splits them into shares
//! (`cut.rs`) and writes these (`file.rs`). The writer may lose shares, which it counts, but never delays the stepping
//! thread. The other files read logs, all of them through `records.rs`, which accepts untrusted bytes.

mod collector;
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
mod shares;
mod source;
mod survey;
#[cfg(test)]
pub(crate) mod tests;
mod writer;

pub use config::{LogConfig, LogSettings};
pub use error::LogError;
pub use index::{EpisodeId, Index};
pub use join::{Joined, join};
pub use recover::{Loss, Recovered, recover};
pub use replay::{Difference, Replayed, replay};
pub use shares::{LoggedShare, LoggedStep, ReadShares, read_shares};
pub use source::{is_log_name, read_bytes};
pub use survey::{Survey, Topic, survey, totals};

pub(crate) use collector::{EvaluationCollector, evaluation_head};
pub(crate) use file::{LogFile, Origin};
pub(crate) use writer::{Log, LogHandle};

/// Name of the metadata record with the run, task and actor of a log.
pub const METADATA_NAME: &str = "s2mia.log";
/// Name of the metadata record at the end of a log with the numbers of written and lost shares and steps.
pub const TOTALS_NAME: &str = "s2mia.log.totals";
/// Name of the attachment with the task's settings.
const TASK_NAME: &str = "task.json";
/// Name of the attachment with the run's resolved settings.
const SETTINGS_NAME: &str = "config.toml";
