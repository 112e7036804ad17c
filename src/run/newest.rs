//! The runs of the folder `runs`, for commands without an argument.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use learner::run_folder::{RunFolder, STARTS};

use crate::errors::Usage;
use crate::process::home;

/// Where new runs go by default.
const RUNS: &str = "runs";
/// The learner that is asked if there is no run.
const LEARNER: &str = "http://127.0.0.1:50051";

/// `of`, or the run of the checkpoint `of`, or if it is empty the newest run that has a learner, else the newest run, else
/// the default learner.
pub(crate) fn or_newest(of: &str) -> Result<String, Usage> {
    let shown = |run: PathBuf| run.display().to_string();
    match of {
        "" => Ok(newest(Path::new(RUNS)).map_or_else(|| LEARNER.to_owned(), shown)),
        of => home::expanded_text(of).map(|of| shown(RunFolder::of(Path::new(&of)))),
    }
}

/// All runs of the folder `runs`, in the order of their names.
pub(crate) fn all() -> Result<Vec<PathBuf>, Usage> {
    let mut found: Vec<_> = folders(Path::new(RUNS)).collect();
    found.sort();
    if found.is_empty() {
        return Err(Usage::new(format!("there is no run in ./{RUNS}; name the run folders")));
    }
    Ok(found)
}

fn newest(runs: &Path) -> Option<PathBuf> {
    folders(runs).max_by_key(|folder| {
        let is_live = matches!(RunFolder::listening(folder), Ok(Some(_)));
        (is_live, started(folder), folder.clone())
    })
}

fn folders(runs: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = runs.read_dir().into_iter().flatten();
    let folders = entries.filter_map(|entry| Some(entry.ok()?.path()));
    folders.filter(|folder| RunFolder::holds_run(folder))
}

/// When the newest learner of a run started.
fn started(folder: &Path) -> SystemTime {
    let starts = folder.join(STARTS).metadata().and_then(|file| file.modified());
    starts.unwrap_or(SystemTime::UNIX_EPOCH)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use serde_json::json;

    use super::*;

    #[test]
    fn the_newest_run_with_a_learner_comes_before_newer_ones_without() {
        let runs = tempfile::tempdir().unwrap();
        assert_eq!(newest(runs.path()), None);
        let begin = |name: &str, age_secs: u64| {
            let path = runs.path().join(name);
            let run = RunFolder::claim_new(&path).unwrap();
            run.begin("", &json!({"config_sha256": "aa"})).unwrap();
            let started = SystemTime::now() - Duration::from_secs(age_secs);
            let starts = std::fs::File::options().append(true).open(path.join(STARTS));
            starts.unwrap().set_modified(started).unwrap();
            (path, run)
        };
        std::fs::create_dir(runs.path().join("no run")).unwrap();
        let ((old, live), (new, ended)) = (begin("b", 60), begin("a", 0));
        drop(ended);
        live.note_address("127.0.0.1:50051".parse().unwrap()).unwrap();
        assert_eq!(newest(runs.path()), Some(old));
        drop(live);
        assert_eq!(newest(runs.path()), Some(new));
    }
}
