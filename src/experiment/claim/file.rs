//! The file of a claim: its contents and its lock.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::{FileExt as _, MetadataExt as _};
use std::path::Path;

use anyhow::Context as _;
use learner::plain_file;
use serde::{Deserialize, Serialize};

/// Length of a claim file. It never changes, so a reader never sees the rest of a longer text.
pub(super) const BYTES: usize = 512;

/// Contents of a claim file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Holder {
    /// Name of the holder's host; empty if the file is not completely written.
    pub(crate) host: String,
    /// Process id.
    pub(crate) pid: u32,
    /// Id of the start of the host's kernel.
    pub(super) boot: String,
    /// Id of the claim.
    pub(super) id: String,
    /// Number of times that the holder rewrote the claim.
    pub(super) beat: u64,
}

impl Holder {
    /// Name of the host for a message.
    pub(crate) fn host_name(&self) -> String {
        match self.host.is_empty() {
            true => "an unknown host".to_owned(),
            false => self.host.clone(),
        }
    }
}

/// The file, and whether this call created it; `None` if it was removed between the two attempts.
pub(super) fn open(path: &Path) -> anyhow::Result<Option<(File, bool)>> {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    let opened = match options.clone().create_new(true).open(path) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            match plain_file::open(&options, path) {
                Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
                opened => opened.map(|file| (file, false)),
            }
        }
        created => created.map(|file| (file, true)),
    };
    opened.map(Some).with_context(|| format!("cannot write {}", path.display()))
}

/// Whether this process locked the file.
pub(super) fn try_lock(file: &File, path: &Path) -> anyhow::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error).with_context(|| {
            format!("cannot lock {}: its file system must support flock", path.display())
        }),
    }
}

/// Whether the open file is still the one at `path`.
pub(super) fn is_at(file: &File, path: &Path) -> bool {
    match (file.metadata(), std::fs::metadata(path)) {
        (Ok(open), Ok(named)) => (open.dev(), open.ino()) == (named.dev(), named.ino()),
        _ => false,
    }
}

/// The contents; empty if they are incomplete, `None` without a file. Opens the file every time, because NFS shows the
/// writes of other hosts only then.
pub(super) fn read(path: &Path) -> anyhow::Result<Option<Holder>> {
    match plain_file::read(path) {
        Ok(bytes) => Ok(Some(serde_json::from_slice(&bytes).unwrap_or_default())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
    }
}

/// Replaces the contents and waits until the disk has them.
pub(super) fn write(file: &File, holder: &Holder) -> std::io::Result<()> {
    let text = serde_json::to_string(holder)?;
    let line = format!("{text:width$}\n", width = BYTES - 1);
    file.write_all_at(line.as_bytes(), 0)?;
    file.sync_data()
}
