//! Where a run may begin: outside other runs, and in a folder without files of others or links in the place of its own;
//! and whether that is still the folder that this process locked.

use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};

use super::token::TOKEN;
use super::{
    ADDRESS, CONFIG, LOCK, LOGS, MANIFEST, METRICS, PROVENANCE, RunFolder, RunFolderError, STARTS,
    TENSORBOARD,
};
use crate::store::durable::{self, DRAFT, FileError};
use crate::store::{checkpoint, plain_file};

/// Names that a run writes into its folder; drafts begin with [`DRAFT`].
const OWN: [&str; 11] = [
    ADDRESS,
    checkpoint::FOLDER,
    CONFIG,
    LOCK,
    LOGS,
    MANIFEST,
    METRICS,
    PROVENANCE,
    STARTS,
    TENSORBOARD,
    TOKEN,
];
/// Folder in the root of a file system.
const LOST_AND_FOUND: &str = "lost+found";

/// Why a folder cannot be that of a run.
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// The folder is inside another run.
    #[error(
        "{path} is inside the run {run}, and no run starts inside another; choose another folder"
    )]
    InsideRun {
        /// The folder.
        path: PathBuf,
        /// The run, or the checkpoint.
        run: PathBuf,
    },
    /// A file of the run is a link, a pipe or a device.
    #[error(
        "{path} cannot be written: {why}; remove it, or move the whole run folder and link to that"
    )]
    NotPlain {
        /// The file or folder.
        path: PathBuf,
        /// What it is.
        why: String,
    },
}

impl RunFolder {
    /// Whether the folder contains a run: a manifest, or checkpoints whose manifest is lost. A checkpoint's folder does not.
    #[must_use]
    pub fn holds_run(path: &Path) -> bool {
        (path.join(MANIFEST).exists() || checkpoint::folder(path).exists())
            && !checkpoint::is_checkpoint(path)
    }

    /// The run, or the checkpoint outside any run, whose folder contains the folder `path`. `path` need not exist.
    #[must_use]
    pub fn around(path: &Path) -> Option<PathBuf> {
        let whole = resolved(path);
        let mut above = whole.ancestors().skip(1);
        above.find(|folder| is_run(folder) || checkpoint::is_checkpoint(folder)).map(|found| {
            match found.parent().and_then(Path::parent).filter(|run| is_run(run)) {
                Some(run) if checkpoint::is_checkpoint(found) => run.to_path_buf(),
                _ => found.to_path_buf(),
            }
        })
    }

    /// The run that `path` names: its folder, or that of one of its checkpoints. A checkpoint outside a run stands for
    /// itself.
    #[must_use]
    pub fn of(path: &Path) -> PathBuf {
        let run = Self::around(path).filter(|_| checkpoint::is_checkpoint(path));
        run.unwrap_or_else(|| path.to_path_buf())
    }

    /// Refuses a folder inside another run.
    ///
    /// # Errors
    /// Names the folder and the run.
    pub fn demand_outside_runs(path: &Path) -> Result<(), PlaceError> {
        match Self::around(path) {
            None => Ok(()),
            Some(run) => Err(PlaceError::InsideRun { path: path.to_path_buf(), run }),
        }
    }

    /// Refuses to write if the path no longer leads to the locked folder, or if the folder was emptied.
    ///
    /// # Errors
    /// Names the folder.
    pub(crate) fn demand_in_place(&self) -> Result<(), RunFolderError> {
        let (lock, folder) = &self.locks;
        let same = folder.as_ref().is_none_or(|open| durable::leads_to(&self.path, open));
        // A deleted lock file alone is harmless: the folder's own lock holds.
        let emptied =
            || !durable::leads_to(&self.file(LOCK), lock) && !durable::exists(&self.file(MANIFEST));
        if same && !emptied() {
            return Ok(());
        }
        Err(RunFolderError::Lost { path: self.path.clone() })
    }

    /// A file or folder in `path` that no start of a run left there; `None` if the folder does not exist.
    ///
    /// # Errors
    /// Names the folder if it cannot be read.
    pub fn file_of_others(path: &Path) -> Result<Option<PathBuf>, FileError> {
        let names = entries(path)?;
        let started = names.iter().any(|name| name == LOCK);
        let is_left = |name: &OsStr| {
            (started && is_own(name)) || name == LOST_AND_FOUND || is_actors_logs(path, name)
        };
        Ok(names.into_iter().find(|name| !is_left(name)).map(|name| path.join(name)))
    }
}

/// Refuses links, pipes and devices in the place of the run's own files.
pub(super) fn demand_plain(path: &Path) -> Result<(), PlaceError> {
    let own = entries(path).unwrap_or_default().into_iter().filter(|name| is_own(name));
    for own in own.map(|name| path.join(name)) {
        let is_folder = own.symlink_metadata().is_ok_and(|found| found.is_dir());
        if let Some(why) = plain_file::refusal(&own).filter(|_| !is_folder) {
            return Err(PlaceError::NotPlain { path: own, why: why.to_string() });
        }
    }
    Ok(())
}

/// Not every file system has locks.
pub(super) fn not_lockable(place: &Path, error: &io::Error) -> RunFolderError {
    let why = format!("its file system must support flock ({error})");
    FileError::of("lock", place)(io::Error::other(why)).into()
}

/// Whether the folder has more of a run than another program's `manifest.json` or `checkpoints`.
fn is_run(folder: &Path) -> bool {
    let has = |name: &str| folder.join(name).exists();
    let of_run = has(MANIFEST) || has(STARTS) || checkpoint::folder(folder).exists();
    let has_checkpoint = || matches!(checkpoint::newest_iteration(folder), Ok(Some(_)));
    (of_run && (has(CONFIG) || has(LOCK))) || has_checkpoint()
}

/// The path without links, as far as it exists.
fn resolved(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let real = |there: &Path| {
        let rest = whole.strip_prefix(there).ok()?;
        Some(there.canonicalize().ok()?.join(rest))
    };
    whole.ancestors().find_map(real).unwrap_or_else(|| whole.clone())
}

fn is_own(name: &OsStr) -> bool {
    OWN.iter().any(|own| name == *own) || name.to_string_lossy().starts_with(DRAFT)
}

/// Whether this is the folder of logs, which is made before the run's other files, with nothing but logs of actors.
fn is_actors_logs(folder: &Path, name: &OsStr) -> bool {
    let is_log = |name: &OsStr| name.to_string_lossy().starts_with("actor_");
    name == LOGS && entries(&folder.join(LOGS)).is_ok_and(|names| names.iter().all(|n| is_log(n)))
}

/// Names in a folder, sorted; none if it does not exist.
fn entries(folder: &Path) -> Result<Vec<std::ffi::OsString>, FileError> {
    let listed = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        listed => listed.map_err(FileError::of("read", folder))?,
    };
    let name = |entry: io::Result<std::fs::DirEntry>| entry.map(|entry| entry.file_name());
    let names = listed.map(name).collect::<io::Result<Vec<_>>>();
    let mut names = names.map_err(FileError::of("read", folder))?;
    names.sort();
    Ok(names)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::process::Command;

    use serde_json::json;

    use super::*;

    /// A folder with a run in `run`.
    fn with_run() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let claimed = RunFolder::claim_new(&run).unwrap();
        claimed.begin("", &json!({"config_sha256": "aa"})).unwrap();
        (folder, run)
    }

    #[test]
    fn no_run_starts_in_any_folder_of_another_run() {
        let (folder, run) = with_run();
        let link = folder.path().join("link");
        symlink(&run, &link).unwrap();
        let inside = ["checkpoints/iter_00000001", "logs", "new/sub"].map(|name| run.join(name));
        std::fs::create_dir_all(&inside[0]).unwrap();
        for place in [&inside[..], &[link.join("logs")]].concat() {
            let error = RunFolder::claim_new(&place).unwrap_err().to_string();
            assert!(error.contains("is inside the run") && error.contains("/run,"), "{error}");
        }
        assert!(!run.join("new").exists());
        RunFolder::claim_new(&folder.path().join("beside")).unwrap();
    }

    #[test]
    fn folders_of_other_programs_contain_no_run() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(MANIFEST), "{}").unwrap();
        std::fs::create_dir(folder.path().join("checkpoints")).unwrap();
        assert_eq!(RunFolder::around(&folder.path().join("runs/a")), None);
    }

    #[test]
    fn only_what_a_start_of_a_run_left_is_not_a_file_of_others() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let others = || RunFolder::file_of_others(path).unwrap();
        assert_eq!(RunFolder::file_of_others(&path.join("none")).unwrap(), None);
        std::fs::create_dir(path.join(LOGS)).unwrap();
        std::fs::write(path.join("logs/actor_0.log"), "").unwrap();
        assert_eq!(others(), None);
        std::fs::write(path.join(CONFIG), "").unwrap();
        assert_eq!(others(), Some(path.join(CONFIG)));
        std::fs::write(path.join(LOCK), "").unwrap();
        assert_eq!(others(), None);
        std::fs::write(path.join("thesis.tex"), "").unwrap();
        assert_eq!(others(), Some(path.join("thesis.tex")));
    }

    #[test]
    fn a_file_system_without_locks_is_named_as_the_reason() {
        let error = not_lockable(Path::new("a/learner.lock"), &io::ErrorKind::Unsupported.into());
        let line = "cannot lock a/learner.lock: its file system must support flock (unsupported)";
        assert_eq!(error.to_string(), line);
    }

    #[test]
    fn a_link_or_a_pipe_in_the_place_of_a_runs_file_is_refused_and_left_as_it_is() {
        let (folder, run) = with_run();
        let elsewhere = folder.path().join("elsewhere");
        std::fs::write(&elsewhere, "mine").unwrap();
        for name in [CONFIG, LOCK, "metrics.jsonl", ".tmp-config.toml", "checkpoints"] {
            let path = run.join(name);
            let before = std::fs::rename(&path, run.join("before")).is_ok();
            symlink(&elsewhere, &path).unwrap();
            let error = RunFolder::claim_existing(&run, "aa").unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("it is a link"), "{error}");
            std::fs::remove_file(&path).unwrap();
            assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
            let error = RunFolder::claim_existing(&run, "aa").unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("it is a pipe"), "{error}");
            std::fs::remove_file(&path).unwrap();
            assert!(!before || std::fs::rename(run.join("before"), &path).is_ok());
        }
        assert_eq!(std::fs::read_to_string(&elsewhere).unwrap(), "mine");
        RunFolder::claim_existing(&run, "aa").unwrap();
    }

    fn run(path: &Path) -> RunFolder {
        let run = RunFolder::claim_new(path).unwrap();
        run.begin("", &json!({"config_sha256": "aa"})).unwrap();
        run.demand_in_place().unwrap();
        run
    }

    #[test]
    fn a_renamed_a_replaced_and_a_deleted_folder_are_lost() {
        let folder = tempfile::tempdir().unwrap();
        let (path, moved) = (folder.path().join("run"), folder.path().join("moved"));
        let first = run(&path);
        std::fs::rename(&path, &moved).unwrap();
        let message = first.demand_in_place().unwrap_err().to_string();
        assert!(message.starts_with(&format!("{} was renamed", path.display())), "{message}");
        let second = run(&path);
        first.demand_in_place().unwrap_err();
        std::fs::remove_dir_all(&path).unwrap();
        second.demand_in_place().unwrap_err();
        std::fs::rename(&moved, &path).unwrap();
        first.demand_in_place().unwrap();
    }

    #[test]
    fn an_emptied_folder_is_lost_and_one_without_its_lock_file_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let run = run(folder.path());
        std::fs::remove_file(folder.path().join(LOCK)).unwrap();
        run.demand_in_place().unwrap();
        std::fs::remove_file(folder.path().join(MANIFEST)).unwrap();
        run.demand_in_place().unwrap_err();
    }
}
