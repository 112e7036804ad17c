//! `s2mia log`: tools for trajectory logs, one file each.

mod info;
mod join;
mod recover;
mod replay;
mod verify;

use std::path::{Path, PathBuf};

use actor::LogError;
use actor::trajectory_log::{Index, is_log_name};
use anyhow::Context as _;
use proto::is_reward_log_name;

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

/// The logs that are meant, each once, in the order of their names within a folder.
fn paths(logs: &LogFiles) -> anyhow::Result<Vec<PathBuf>> {
    paths_with(logs, |_| false)
}

/// All shares of the logs that are meant, and their intrinsic rewards, which lie beside them.
fn index(logs: &LogFiles) -> anyhow::Result<Index> {
    let mut index = Index::default();
    for path in paths_with(logs, is_reward_log_name)? {
        in_file(&path, index.add(&path))?;
    }
    if index.logs() == 0 {
        let why = "reward logs alone; name the trajectory logs that they belong to, too";
        return Err(Usage::new(why.to_owned()).into());
    }
    Ok(index)
}

/// Of folders, trajectory logs and files that are `more`.
fn paths_with(logs: &LogFiles, more: fn(&str) -> bool) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = Vec::new();
    for given in &logs.files {
        let found = if given.is_dir() { in_folder(given, more)? } else { vec![given.clone()] };
        for path in found {
            if !paths.contains(&path) {
                paths.push(path);
            }
        }
    }
    Ok(paths)
}

fn in_folder(folder: &Path, more: fn(&str) -> bool) -> anyhow::Result<Vec<PathBuf>> {
    let entries = folder.read_dir().with_context(|| format!("cannot read {}", folder.display()))?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names.filter(|name| is_log_name(name) || more(name)).collect();
    names.sort();
    if !names.iter().any(|name| is_log_name(name)) {
        let why =
            format!("no trajectories-*.mcap in {}; log.episodes makes some", folder.display());
        return Err(Usage::new(why).into());
    }
    Ok(names.iter().map(|name| folder.join(name)).collect())
}

/// The same with the file's name before it.
fn in_file<T>(path: &Path, result: Result<T, LogError>) -> anyhow::Result<T> {
    result.with_context(|| path.display().to_string())
}
