//! The arguments for an actor's trajectory logs and for the log tools.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// Trajectory logging of an actor.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ActorLogArguments {
    /// Folder for trajectory logs (MCAP).
    #[arg(long, value_name = "DIR", requires = "log_episodes")]
    pub(crate) log_dir: Option<PathBuf>,
    /// Episodes to log, as in log.episodes: evaluation, all, or a number N for one episode in N.
    #[arg(long, value_name = "WHICH", requires = "log_dir")]
    pub(crate) log_episodes: Option<String>,
    /// File size after which the log continues in a new file [default: log.max_file_mib].
    #[arg(long, value_name = "MIB", requires = "log_dir")]
    pub(crate) log_max_file_mib: Option<u64>,
}

/// `s2mia log`
#[derive(Debug, Subcommand)]
pub(crate) enum LogCommand {
    /// Verify checksums, schemas and that every share is complete. Exit status 3: shares are missing.
    Verify(LogFiles),
    /// Step the simulator with the logged actions and compare every observation, state and reward, bit for bit.
    Replay(LogFiles),
}

/// Logs.
#[derive(Args, Debug)]
pub(crate) struct LogFiles {
    /// MCAP files, or folders with trajectories-*.mcap.
    #[arg(required = true, value_name = "FILE | DIR")]
    pub(crate) files: Vec<PathBuf>,
}
