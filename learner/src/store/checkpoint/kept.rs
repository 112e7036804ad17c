//! Which checkpoints stand in a folder, and which of them stay.

use std::path::Path;

use super::{CheckpointError, DRAFT, LATEST, name};
use crate::config::CheckpointConfig;
use crate::durable::{self, FileError};

/// Iterations of all checkpoints in `folder`, ascending; drafts and other files do not count.
pub(super) fn iterations(folder: &Path) -> Result<Vec<u64>, FileError> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(FileError::of("read", folder))?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let file_name = entry.map_err(FileError::of("read", folder))?.file_name();
        let file_name = file_name.to_string_lossy();
        let digits = file_name.strip_prefix("iter_").and_then(|digits| digits.parse().ok());
        found.extend(digits.filter(|iteration| name(*iteration) == file_name));
    }
    found.sort_unstable();
    Ok(found)
}

/// The iteration that `LATEST` names; `None` if it names none.
pub(crate) fn named_latest(run_folder: &Path) -> Option<u64> {
    let text = std::fs::read_to_string(super::folder(run_folder).join(LATEST)).ok()?;
    let iteration = text.trim().strip_prefix("iter_")?.parse().ok()?;
    (name(iteration) == text.trim()).then_some(iteration)
}

/// Removes all but the newest `keep_last` up to `newest` and the multiples of `keep_every`, and drafts that
/// a crash left. Checkpoints beyond `newest` were passed over as damaged; they stay until their iteration is
/// written again.
pub(super) fn prune(
    folder: &Path,
    newest: u64,
    keep: &CheckpointConfig,
) -> Result<(), CheckpointError> {
    let written = iterations(folder)?.into_iter().filter(|iteration| *iteration <= newest);
    for iteration in written.rev().skip(keep.keep_last) {
        if !keep.stays_for_ever(iteration) {
            durable::remove_folder(&folder.join(name(iteration)))?;
        }
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
