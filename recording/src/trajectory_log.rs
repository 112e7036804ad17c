//! Trajectory logs: the steps of actors as MCAP files, for Foxglove, Python and replay in the simulator.
//!
//! A log consists of shares: the steps of one episode in one lease. The stepping thread only collects them
//! (`collector.rs`) and sends those of whole leases to the log-writer thread (`writer.rs`), which writes them
//! (`file.rs`). The writer may lose shares, which it counts, but never delays the stepping
//! thread. The other files read logs, all of them through `records.rs`, which accepts untrusted bytes.

mod collector;
mod config;
mod error;
mod file;
mod records;
mod replay;
mod shares;
mod source;
#[cfg(test)]
mod tests;
mod writer;

pub use collector::ShareCollector;
pub use config::{FILE_BYTES, LogConfig, LogSettings};
pub use error::LogError;
pub use replay::{ReplayDifference, Replayed, replay};
pub use shares::{ReadShares, read_shares, totals};
pub use source::{is_log_name, read_bytes};
pub use writer::{Log, LogHandle};

pub(crate) use file::{LogFile, Origin};
