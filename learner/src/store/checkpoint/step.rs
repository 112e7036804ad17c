//! The steps of writing a checkpoint, so that tests can let each of them fail.

use std::io;
use std::path::Path;

use crate::store::durable::FileError;

/// A step of writing a checkpoint, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The draft's folder is made.
    MakeFolder,
    /// One of its files is written; the manifest is the last.
    WriteFile,
    /// The files are flushed to disk.
    FlushFiles,
    /// The folder is renamed to its place.
    Rename,
    /// The new name is flushed to disk.
    FlushName,
    /// `LATEST` is replaced.
    NameLatest,
    /// Old checkpoints are removed.
    RemoveOld,
}

/// Called before each step with its file or folder; an error ends the attempt like one of the disk.
pub type Before<'a> = dyn FnMut(Step, &Path) -> io::Result<()> + 'a;

pub(super) fn about_to(before: &mut Before<'_>, step: Step, path: &Path) -> Result<(), FileError> {
    before(step, path).map_err(FileError::of("write", path))
}
