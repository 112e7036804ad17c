//! Which checkpoints a folder has, which of them stay, and copies of them.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::{
    CheckpointError, LATEST, Loaded, MANIFEST, POLICY, RunSettings, SETTINGS, Saved, name, save,
};
use crate::store::durable::{self, DRAFT, FileError};
use crate::store::plain_file;

/// Name of the folder of checkpoints in a run folder.
pub(crate) const FOLDER: &str = "checkpoints";

/// Iterations of all checkpoints in `folder`, ascending; drafts and other files do not count.
pub(super) fn iterations(folder: &Path) -> Result<Vec<u64>, FileError> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(FileError::of("read", folder))?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let file_name = entry.map_err(FileError::of("read", folder))?.file_name();
        found.extend(iteration(&file_name));
    }
    found.sort_unstable();
    Ok(found)
}

/// Iterations of all checkpoints of a run, ascending, whole or not.
///
/// # Errors
/// The folder of checkpoints cannot be read.
pub fn all(run_folder: &Path) -> Result<Vec<u64>, CheckpointError> {
    Ok(iterations(&run_folder.join(FOLDER))?)
}

/// The folder of the checkpoint of an iteration.
#[must_use]
pub fn place(run_folder: &Path, iteration: u64) -> PathBuf {
    run_folder.join(FOLDER).join(name(iteration))
}

impl Loaded {
    /// Writes a copy, with these settings as its own, into the folder of another run.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn copy_to(&self, run_folder: &Path, toml: &str) -> Result<Saved, CheckpointError> {
        let settings = RunSettings { sha256: &self.manifest.config_sha256, toml };
        let keep = Keep { newest: usize::MAX, returns: &BTreeMap::new(), outstanding: None };
        save(run_folder, &self.checkpoint, settings, &keep, &mut |_, _| Ok(()))
    }
}

/// The iteration that `LATEST` in a folder of checkpoints names; `None` if it names none.
pub(crate) fn named_latest(folder: &Path) -> Option<u64> {
    let text = plain_file::read_to_string(&folder.join(LATEST)).ok()?;
    iteration(OsStr::new(text.trim()))
}

/// The iteration of the checkpoint with this name.
fn iteration(file_name: &OsStr) -> Option<u64> {
    let file_name = file_name.to_str()?;
    let digits = file_name.strip_prefix("iter_").and_then(|digits| digits.parse().ok());
    digits.filter(|iteration| name(*iteration) == file_name)
}

/// Whether a checkpoint of some iteration has this name.
pub(super) fn is_name(file_name: &OsStr) -> bool {
    iteration(file_name).is_some()
}

/// Whether nothing is at `path`.
pub(super) fn is_gone(path: &Path) -> bool {
    path.symlink_metadata().is_err_and(|error| error.kind() == ErrorKind::NotFound)
}

/// Whether the folder is that of a checkpoint, whole or damaged, in its run or a copy elsewhere.
#[must_use]
pub fn is_checkpoint(path: &Path) -> bool {
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let parent = whole.parent().and_then(Path::file_name);
    let in_place =
        parent.is_some_and(|parent| parent == FOLDER) && whole.file_name().is_some_and(is_name);
    let has = |name: &str| whole.join(name).is_file();
    // A run folder may have the policy as an exported file.
    let is_copy =
        || has(POLICY) && (has(MANIFEST) || has(SETTINGS)) && is_gone(&whole.join(FOLDER));
    whole.is_dir() && (in_place || is_copy())
}

/// Which checkpoints stay: the newest, the one with the best evaluation, and the one whose evaluation is outstanding.
#[derive(Clone, Copy, Debug)]
pub struct Keep<'a> {
    /// How many of the newest stay.
    pub newest: usize,
    /// Mean returns of evaluations, by iteration.
    pub returns: &'a BTreeMap<u64, f64>,
    /// Iteration of the evaluation whose result is outstanding.
    pub outstanding: Option<u64>,
}

/// The checkpoint of a run with the highest return of an evaluation; of equal ones the newest. `None` if none is evaluated.
///
/// # Errors
/// The folder of checkpoints cannot be read.
pub fn best(run_folder: &Path, returns: &BTreeMap<u64, f64>) -> Result<Option<PathBuf>, FileError> {
    let folder = super::folder(run_folder);
    let best = best_of(&iterations(&folder)?, returns);
    Ok(best.map(|iteration| folder.join(name(iteration))))
}

fn best_of(iterations: &[u64], returns: &BTreeMap<u64, f64>) -> Option<u64> {
    let evaluated = iterations.iter().filter_map(|it| Some((*it, *returns.get(it)?)));
    evaluated.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(iteration, _)| iteration)
}

/// Removes all checkpoints up to `newest` but those to `keep`, and drafts that a crash left. Checkpoints beyond `newest` are
/// damaged; they stay until their iteration is written again.
pub(super) fn prune(folder: &Path, newest: u64, keep: &Keep<'_>) -> Result<(), CheckpointError> {
    let mut written = iterations(folder)?;
    written.retain(|iteration| *iteration <= newest);
    let stay = [best_of(&written, keep.returns), keep.outstanding];
    let old = written.into_iter().rev().skip(keep.newest);
    for iteration in old.filter(|iteration| !stay.contains(&Some(*iteration))) {
        remove(folder, &name(iteration))?;
    }
    let entries = std::fs::read_dir(folder).map_err(FileError::of("read", folder))?;
    for entry in entries.flatten() {
        let is_draft = entry.file_name().to_string_lossy().starts_with(DRAFT);
        if is_draft && entry.path().is_dir() {
            durable::remove_folder(&entry.path())?;
        }
    }
    Ok(())
}

/// Removes a checkpoint at once for its readers: it is renamed before its files are removed.
fn remove(folder: &Path, name: &str) -> Result<(), FileError> {
    let place = folder.join(name);
    let draft = folder.join(format!("{DRAFT}{name}"));
    durable::remove_folder(&draft)?;
    std::fs::rename(&place, &draft).map_err(FileError::of("remove", &place))?;
    durable::remove_folder(&draft)
}
