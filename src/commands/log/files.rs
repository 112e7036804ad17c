//! The log files that `s2mia log` reads.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use proto::is_reward_log_name;
use recording::trajectory_log::{Index, LogError, is_log_name};

use crate::cli::LogFiles;
use crate::errors::Usage;
use crate::figures::chart::thousands;
use crate::progress::WorkProgress;
use crate::run::run_path;

/// The trajectory logs that the arguments name, each once, ordered by name within a folder.
pub(super) fn paths(logs: &LogFiles) -> anyhow::Result<Vec<PathBuf>> {
    let paths = paths_of(logs, is_log_name)?;
    let is_reward_log = |path: &&PathBuf| run_path::file_name(path).is_some_and(is_reward_log_name);
    match paths.iter().find(is_reward_log) {
        None => Ok(paths),
        Some(path) => {
            let shown = path.display();
            let why = format!("{shown} is a reward log, which `s2mia log verify` and `join` read");
            Err(Usage::new(why).into())
        }
    }
}

/// All shares of the logs that the arguments name, with the intrinsic rewards that learners log.
pub(super) fn index(logs: &LogFiles, progress: &mut WorkProgress) -> anyhow::Result<Index> {
    let paths = paths_of(logs, |name| is_log_name(name) || is_reward_log_name(name))?;
    let (mut index, mut done, all) = (Index::default(), 0, sizes(&paths));
    for path in &paths {
        in_file(path, index.add(path))?;
        done += size(path);
        progress.reach(done, all, || format!("read {}", run_path::name(path)));
    }
    if index.logs() == 0 {
        let why = "reward logs alone; name the trajectory logs that they belong to, too";
        return Err(Usage::new(why).into());
    }
    Ok(index)
}

/// Bytes of all files together.
pub(super) fn sizes(paths: &[PathBuf]) -> u64 {
    paths.iter().map(|path| size(path)).sum()
}

/// Bytes of a file, for progress; 0 if it cannot be read, which reading it reports.
pub(super) fn size(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |file| file.len())
}

/// Number of shares with intrinsic rewards, as text.
pub(super) fn paid(index: &Index) -> String {
    let (paid, all) = index.paid();
    format!("intrinsic rewards of {} of {} training shares", thousands(paid), thousands(all))
}

/// The named files; for a folder, its files whose names `belong`.
fn paths_of(logs: &LogFiles, belong: fn(&str) -> bool) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = Vec::new();
    for given in &logs.files {
        let found = if given.is_dir() { in_folder(given, belong)? } else { vec![given.clone()] };
        for path in found {
            if !paths.contains(&path) {
                paths.push(path);
            }
        }
    }
    Ok(paths)
}

/// The files of a folder whose names `belong`; for a run folder, those of its logs.
fn in_folder(folder: &Path, belong: fn(&str) -> bool) -> anyhow::Result<Vec<PathBuf>> {
    let run = run_path::run_of(folder);
    let logs = run_path::logs(&run);
    let is_run = run_path::config_file(&run).is_file() && logs.is_dir();
    let folder = if is_run { &logs } else { folder };
    let paths = run_path::files(folder, belong);
    let paths = paths.with_context(|| format!("cannot read {}", folder.display()))?;
    if paths.is_empty() {
        let why =
            format!("no trajectories-*.mcap in {}; log.episodes makes some", folder.display());
        return Err(Usage::new(why).into());
    }
    Ok(paths)
}

/// Adds the path of the file to an error.
pub(super) fn in_file<T>(path: &Path, result: Result<T, LogError>) -> anyhow::Result<T> {
    result.with_context(|| path.display().to_string())
}
