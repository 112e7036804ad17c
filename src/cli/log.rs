//! The arguments that say what an actor logs, and those of the tools for logs.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// What an actor logs.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ActorLogArguments {
    /// Folder for trajectory logs (MCAP).
    #[arg(long, value_name = "DIR", requires = "log_episodes")]
    pub(crate) log_dir: Option<PathBuf>,
    /// Which episodes: evaluation, all, or one in so many, as log.episodes says it.
    #[arg(long, value_name = "WHICH", requires = "log_dir")]
    pub(crate) log_episodes: Option<String>,
    /// Size after which a log goes on in another file [default: log.max_file_mib].
    #[arg(long, value_name = "MIB", requires = "log_dir")]
    pub(crate) log_max_file_mib: Option<u64>,
}

/// `s2mia log`
#[derive(Debug, Subcommand)]
pub(crate) enum LogCommand {
    /// Say what MCAP files hold: one table.
    Info(LogFiles),
    /// Check checksums, schemas, that every share of every episode is there once, and that the learner's intrinsic
    /// rewards belong to them; status 3 if shares are missing.
    Verify(LogFiles),
    /// Save what is whole in a damaged or unfinished file; status 3 if something was lost.
    Recover(RecoverArguments),
    /// Step the simulator with the logged actions and compare every observation, state and reward, bit for bit.
    Replay(LogFiles),
    /// Put the shares of episodes together into one file, ordered by episode and step, with their intrinsic rewards.
    Join(JoinArguments),
}

/// Logs.
#[derive(Args, Debug)]
pub(crate) struct LogFiles {
    /// MCAP files, or folders with trajectories-*.mcap; to verify and join also rewards-*.jsonl.
    #[arg(required = true, value_name = "FILE | DIR")]
    pub(crate) files: Vec<PathBuf>,
}

/// `s2mia log recover`
#[derive(Args, Debug)]
pub(crate) struct RecoverArguments {
    /// MCAP file.
    pub(crate) file: PathBuf,
    /// New file for what is whole.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
}

/// `s2mia log join`
#[derive(Args, Debug)]
pub(crate) struct JoinArguments {
    /// Logs.
    #[command(flatten)]
    pub(crate) logs: LogFiles,
    /// New file for the episodes.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
}
