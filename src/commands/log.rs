//! `s2mia log`: tools for trajectory logs, one file each.

mod files;
mod replay;
mod verify;

use crate::cli::LogCommand;

/// Runs one tool.
pub(super) fn run(command: &LogCommand) -> anyhow::Result<()> {
    match command {
        LogCommand::Verify(files) => verify::run(files),
        LogCommand::Replay(files) => replay::run(files),
    }
}
