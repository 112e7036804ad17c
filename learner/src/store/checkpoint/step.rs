//! The steps on the way to a checkpoint that stands, so that each can be made to fail.

use std::io;
use std::path::Path;

use crate::durable::FileError;

/// A step on the way to a checkpoint that stands, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The folder for its files is made, beside its place.
    MakeFolder,
    /// One of its files is written; the manifest is the last.
    WriteFile,
    /// The disk is to have all of them.
    FlushFiles,
    /// The folder is renamed to its place.
    Rename,
    /// The disk is to have the new name.
    FlushName,
    /// `LATEST` is replaced.
    NameLatest,
    /// What need not stay is removed.
    RemoveOld,
}

impl Step {
    /// All of them, in order.
    pub const ALL: [Self; 7] = [
        Self::MakeFolder,
        Self::WriteFile,
        Self::FlushFiles,
        Self::Rename,
        Self::FlushName,
        Self::NameLatest,
        Self::RemoveOld,
    ];

    fn deed(self) -> &'static str {
        match self {
            Self::MakeFolder => "make",
            Self::WriteFile => "write",
            Self::FlushFiles | Self::FlushName => "flush",
            Self::Rename | Self::NameLatest => "replace",
            Self::RemoveOld => "clear",
        }
    }
}

/// Called before each step with the file or folder it is about; an error stands for one of the disk's.
pub type Before<'a> = dyn FnMut(Step, &Path) -> io::Result<()> + 'a;

pub(super) fn about_to(before: &mut Before<'_>, step: Step, path: &Path) -> Result<(), FileError> {
    before(step, path).map_err(FileError::of(step.deed(), path))
}
