//! `s2mia log`: tools for trajectory logs, one file each.

mod info;
mod join;
mod recover;
mod replay;
mod verify;

use std::path::{Path, PathBuf};

use actor::LogError;
use actor::trajectory_log::is_log_name;
use anyhow::Context as _;

use crate::cli::{LogCommand, LogFiles};
use crate::commands::Usage;

/// What is left is sound, but something is missing; the program ends with status 3.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Incomplete(String);

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

/// The files that are meant, each once, in the order of their names within a folder.
fn paths(logs: &LogFiles) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = Vec::new();
    for given in &logs.files {
        let found = if given.is_dir() { in_folder(given)? } else { vec![given.clone()] };
        for path in found {
            if !paths.contains(&path) {
                paths.push(path);
            }
        }
    }
    Ok(paths)
}

fn in_folder(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = folder.read_dir().with_context(|| format!("cannot read {}", folder.display()))?;
    let named =
        |path: &PathBuf| path.file_name().and_then(|name| name.to_str()).is_some_and(is_log_name);
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<PathBuf> = paths.filter(named).collect();
    paths.sort();
    if paths.is_empty() {
        let why =
            format!("no trajectories-*.mcap in {}; log.episodes makes some", folder.display());
        return Err(Usage::new(why).into());
    }
    Ok(paths)
}

/// The same with the file's name before it.
fn in_file<T>(path: &Path, result: Result<T, LogError>) -> anyhow::Result<T> {
    result.with_context(|| path.display().to_string())
}
