//! The arguments for task files.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::ForceArguments;
use crate::process::home;

/// `s2mia task`
#[derive(Debug, Subcommand)]
pub(crate) enum TaskCommand {
    /// Check a task file: print masses, joints and agents, and play episodes of random actions.
    Check(TaskCheckArguments),
    /// Write an example into a folder: a task file with its model, which can be trained.
    New(TaskNewArguments),
}

/// `s2mia task check`
#[derive(Args, Debug)]
pub(crate) struct TaskCheckArguments {
    /// Task file, or FILE:PARTITION if it has several partitions.
    #[arg(value_name = "FILE", value_parser = home::expanded_text)]
    pub(crate) task: String,
    /// Number of episodes of random actions.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) episodes: u32,
    /// Draw eight pictures of the first episode into this PNG file.
    #[arg(long, value_name = "FILE")]
    pub(crate) film: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// `s2mia task new`
#[derive(Args, Debug)]
pub(crate) struct TaskNewArguments {
    /// Folder of the new files; it is made if necessary.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}
