//! The log files that `s2mia log` reads.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use learner::run_folder::RunFolder;
use recording::trajectory_log::{LogError, is_log_name};

use crate::cli::LogFiles;
use crate::errors::Usage;
use crate::run::run_path;

/// The trajectory logs that the arguments name, each once, ordered by name within a folder.
pub(super) fn paths(logs: &LogFiles) -> anyhow::Result<Vec<PathBuf>> {
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

/// Bytes of all files together.
pub(super) fn sizes(paths: &[PathBuf]) -> u64 {
    paths.iter().map(|path| size(path)).sum()
}

/// Bytes of a file, for progress; 0 if it cannot be read, which reading it reports.
pub(super) fn size(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |file| file.len())
}

/// The logs of a folder; for a run folder, those of the run.
fn in_folder(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let run = RunFolder::of(folder);
    let logs = run_path::logs(&run);
    let is_run = run_path::config_file(&run).is_file() && logs.is_dir();
    let folder = if is_run { &logs } else { folder };
    let paths = run_path::files(folder, is_log_name);
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
