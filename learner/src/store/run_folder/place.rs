//! Where a run may begin: outside other runs, and in a folder without files of others or links in the place of its own;
//! and whether that is still the folder that this process locked.

use std::ffi::{OsStr, OsString};
use std::io;
use std::path::{Path, PathBuf};

use super::token::TOKEN;
use super::{
    ADDRESS, CONFIG, LOCK, LOGS, MANIFEST, METRICS, PROVENANCE, RunFolder, RunFolderError,
    START_POLICIES, STARTS, TENSORBOARD,
};
use crate::store::durable::{self, DRAFT, FileError};
use crate::store::{checkpoint, plain_file};

/// Names that a run writes into its folder; drafts begin with [`DRAFT`].
const OWN: [&str; 12] = [
    ADDRESS,
    checkpoint::FOLDER,
    CONFIG,
    LOCK,
    LOGS,
    MANIFEST,
    METRICS,
    PROVENANCE,
    START_POLICIES,
    STARTS,
    TENSORBOARD,
    TOKEN,
];
/// Folder in the root of a file system.
const LOST_AND_FOUND: &str = "lost+found";

impl RunFolder {
    /// Whether the folder contains a run: a manifest, or checkpoints whose manifest is lost. A checkpoint's folder does not.
    #[must_use]
    pub fn holds_run(path: &Path) -> bool {
        (path.join(MANIFEST).exists() || checkpoint::folder(path).exists())
            && !checkpoint::is_checkpoint(path)
    }

    /// Whether the folder has the settings of a run that a learner began, with or without a manifest.
    #[must_use]
    pub fn was_started(path: &Path) -> bool {
        path.join(CONFIG).is_file() && [LOCK, STARTS].iter().any(|name| path.join(name).exists())
    }

    /// Refuses a folder in which this user cannot look for a run.
    ///
    /// # Errors
    /// Names the folder and the reason.
    pub fn demand_readable(path: &Path) -> Result<(), FileError> {
        let no_folder = [io::ErrorKind::NotADirectory, io::ErrorKind::InvalidFilename];
        match path.join(MANIFEST).try_exists() {
            Err(error) if !no_folder.contains(&error.kind()) => {
                Err(FileError::of("read", path)(error))
            }
            _ => Ok(()),
        }
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

    /// The run that `path` names: its folder, or that of one of its checkpoints. A checkpoint outside a run is
    /// returned unchanged.
    #[must_use]
    pub fn of(path: &Path) -> PathBuf {
        let run = Self::around(path).filter(|_| checkpoint::is_checkpoint(path));
        run.unwrap_or_else(|| path.to_path_buf())
    }

    /// Refuses a folder inside another run.
    ///
    /// # Errors
    /// Names the folder and the run.
    pub fn demand_outside_runs(path: &Path) -> Result<(), RunFolderError> {
        match Self::around(path) {
            None => Ok(()),
            Some(run) => Err(RunFolderError::Other(format!(
                "{} is inside the run {}, and no run starts inside another; choose another folder",
                path.display(),
                run.display()
            ))),
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

    /// A file or folder in `path` that a run would replace although no run left it there.
    ///
    /// # Errors
    /// Names the folder if it cannot be read.
    pub fn in_place_of_own(path: &Path) -> Result<Option<PathBuf>, FileError> {
        let names = entries(path)?;
        let started = names.iter().any(|name| name == LOCK);
        let is_replaced =
            |name: &&OsString| !started && is_own(name) && !is_actors_logs(path, name);
        Ok(names.iter().find(is_replaced).map(|name| path.join(name)))
    }
}

/// Refuses links, pipes and devices in the place of the run's own files.
pub(super) fn demand_plain(path: &Path) -> Result<(), RunFolderError> {
    let own = entries(path).unwrap_or_default().into_iter().filter(|name| is_own(name));
    for own in own.map(|name| path.join(name)) {
        let is_folder = own.symlink_metadata().is_ok_and(|found| found.is_dir());
        if let Some(why) = plain_file::refusal(&own).filter(|_| !is_folder) {
            return Err(RunFolderError::Other(format!(
                "{} cannot be written: {why}; remove it, or move the whole run folder and link to that",
                own.display()
            )));
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

/// Names in a folder, sorted; none if it does not exist, unless its path is that of a broken link.
fn entries(folder: &Path) -> Result<Vec<OsString>, FileError> {
    let listed = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let broken = durable::broken_link(folder).map(FileError::of("read", folder));
            return broken.map_or(Ok(Vec::new()), Err);
        }
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
    use super::*;

    #[test]
    fn a_folder_that_cannot_be_read_is_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let ring = folder.path().join("ring");
        std::os::unix::fs::symlink(&ring, &ring).unwrap();
        let line = RunFolder::demand_readable(&ring).unwrap_err().to_string();
        assert!(line.contains("cannot read ") && line.contains("ring: Too many"), "{line}");
        assert!(RunFolder::demand_readable(&folder.path().join("none")).is_ok());
    }
}
