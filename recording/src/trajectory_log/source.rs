//! Files of logs: names, folder, content, and new files that appear atomically.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use super::error::{LogError, LogStartError};
use crate::error::RecordError;

const PREFIX: &str = "trajectories-";
const SUFFIX: &str = ".mcap";

/// Creates the folder of a log.
pub(super) fn make_folder(folder: &Path) -> Result<(), LogStartError> {
    std::fs::create_dir_all(folder)
        .map_err(|source| LogStartError::Folder { folder: folder.to_path_buf(), source })
}

/// Name of file number `number` of an actor. Characters that are not safe in file names become `_`.
fn log_name(actor: &str, number: u32) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "._-".contains(letter);
    let actor: String = actor.chars().map(|c| if plain(c) { c } else { '_' }).collect();
    format!("{PREFIX}{actor}-{number:04}{SUFFIX}")
}

/// Whether a file with this name is a trajectory log.
#[must_use]
pub fn is_log_name(name: &str) -> bool {
    name.starts_with(PREFIX) && name.ends_with(SUFFIX)
}

/// Creates a file with the first unused number of this actor.
pub(super) fn new_log(folder: &Path, actor: &str) -> Result<(PathBuf, File), RecordError> {
    let mut number = 0;
    loop {
        let path = folder.join(log_name(actor, number));
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
            opened => return Ok((path, opened?)),
        }
    }
}

/// Reads an MCAP file.
///
/// # Errors
/// If the file cannot be read or is not an MCAP file.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, LogError> {
    let bytes = std::fs::read(path).map_err(LogError::Read)?;
    if bytes.starts_with(mcap::MAGIC) { Ok(bytes) } else { Err(LogError::NotMcap) }
}

/// Opens a file.
pub(super) fn open(path: &Path) -> Result<File, LogError> {
    File::open(path).map_err(LogError::Read)
}

/// Opens a file for reading by lines.
pub(super) fn open_lines(path: &Path) -> Result<BufReader<File>, LogError> {
    Ok(BufReader::new(open(path)?))
}

/// Reads `length` bytes of a file at `offset`.
pub(super) fn read_part(path: &Path, offset: u64, length: u64) -> Result<Vec<u8>, LogError> {
    let mut file = open(path)?;
    file.seek(SeekFrom::Start(offset)).map_err(LogError::Read)?;
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes).map_err(LogError::Read)?;
    Ok(bytes)
}

/// A new file with a temporary name until it is complete; deleted if it is dropped before.
pub(super) struct Draft {
    part: PathBuf,
    path: PathBuf,
}

impl Draft {
    /// Creates a temporary file in the folder of `path`.
    pub(super) fn begin(path: &Path) -> Result<(Self, (PathBuf, File)), LogError> {
        if path.symlink_metadata().is_ok() {
            return Err(LogError::Taken);
        }
        let part = path.with_extension("mcap.part");
        let file = File::create(&part).map_err(RecordError::File)?;
        Ok((Self { part: part.clone(), path: path.to_path_buf() }, (part, file)))
    }

    /// Renames the file, which must be complete and on disk, to its final name. Does not replace an existing file.
    pub(super) fn publish(self) -> Result<(), LogError> {
        match std::fs::hard_link(&self.part, &self.path) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                return Err(LogError::Taken);
            }
            // Not every file system supports links.
            Err(_) => std::fs::rename(&self.part, &self.path).map_err(RecordError::File)?,
        }
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = File::open(folder.unwrap_or(Path::new("."))).map_err(RecordError::File)?;
        Ok(folder.sync_all().map_err(RecordError::File)?)
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        // After a rename the temporary file does not exist.
        let _removed = std::fs::remove_file(&self.part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_has_the_name_of_its_actor_and_stays_in_its_folder() {
        assert_eq!(log_name("local-0", 3), "trajectories-local-0-0003.mcap");
        assert_eq!(log_name("../a b/ü", 0), "trajectories-.._a_b__-0000.mcap");
        assert!(is_log_name(&log_name("host-17", 12)) && !is_log_name("iter_00000004.mcap"));
    }

    #[test]
    fn a_draft_replaces_no_file_and_leaves_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.mcap");
        let count = || std::fs::read_dir(folder.path()).unwrap().count();
        drop(Draft::begin(&path).unwrap());
        assert_eq!(count(), 0);
        let (draft, _) = Draft::begin(&path).unwrap();
        std::fs::write(&path, "another").unwrap();
        assert!(matches!(draft.publish(), Err(LogError::Taken)));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "another");
        assert!(matches!(Draft::begin(&path), Err(LogError::Taken)));
        assert_eq!(count(), 1);
    }
}
