//! `s2mia log`: tools for trajectory logs, one file each.

mod files;
mod info;
mod join;
mod recover;
mod replay;
mod verify;

use crate::cli::LogCommand;

/// Runs one tool.
pub(super) fn run(command: &LogCommand) -> anyhow::Result<()> {
    match command {
        LogCommand::Info(files) => info::run(files),
        LogCommand::Verify(files) => verify::run(files),
        LogCommand::Recover(arguments) => recover::run(arguments),
        LogCommand::Replay(files) => replay::run(files),
        LogCommand::Join(arguments) => join::run(arguments),
    }
}
