//! The arguments for an actor's trajectory logs and for the log tools.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::ForceArguments;

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
    /// Print the contents of MCAP files in one table.
    Info(LogFiles),
    /// Verify checksums, schemas, that every share of every episode exists exactly once, and that the learner's
    /// intrinsic rewards match the shares. Exit status 3: shares are missing.
    Verify(LogFiles),
    /// Recover the intact data of a damaged or unfinished file. Exit status 3: data was lost.
    Recover(RecoverArguments),
    /// Step the simulator with the logged actions and compare every observation, state and reward, bit for bit.
    Replay(LogFiles),
    /// Join the shares of episodes in one file, ordered by episode and step, with their intrinsic rewards.
    Join(JoinArguments),
}

/// Logs.
#[derive(Args, Debug)]
pub(crate) struct LogFiles {
    /// MCAP files, or folders with trajectories-*.mcap; for verify and join also rewards-*.jsonl.
    #[arg(required = true, value_name = "FILE | DIR")]
    pub(crate) files: Vec<PathBuf>,
}

/// `s2mia log recover`
#[derive(Args, Debug)]
pub(crate) struct RecoverArguments {
    /// MCAP file.
    pub(crate) file: PathBuf,
    /// New file for the recovered data.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// `s2mia log join`
#[derive(Args, Debug)]
pub(crate) struct JoinArguments {
    /// Logs.
    #[command(flatten)]
    pub(crate) logs: LogFiles,
    /// New file for the joined episodes.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}
