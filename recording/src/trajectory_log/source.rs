//! Files of logs: names, folder and content.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use super::error::LogError;
use crate::error::RecordError;

const PREFIX: &str = "trajectories-";
const SUFFIX: &str = ".mcap";

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

/// Creates the folder of an actor's logs.
pub(super) fn make_folder(folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)
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
    let mut file = open(path)?;
    let mut bytes = Vec::new();
    let magic = mcap::MAGIC.len() as u64;
    file.by_ref().take(magic).read_to_end(&mut bytes).map_err(LogError::Read)?;
    if bytes != mcap::MAGIC {
        return Err(LogError::NotMcap);
    }
    file.read_to_end(&mut bytes).map_err(LogError::Read)?;
    Ok(bytes)
}

/// Opens a plain file: a pipe would block, and a device may have no end.
pub(super) fn open(path: &Path) -> Result<File, LogError> {
    let found = std::fs::metadata(path).map_err(LogError::Read)?;
    if !found.is_file() {
        let what = if found.is_dir() { "a directory" } else { "a pipe, device or socket" };
        let why = format!("it is {what}, not a plain file");
        return Err(LogError::Read(std::io::Error::other(why)));
    }
    File::open(path).map_err(LogError::Read)
}

/// Reads `length` bytes of a file at `offset`.
pub(super) fn read_part(path: &Path, offset: u64, length: u64) -> Result<Vec<u8>, LogError> {
    let mut file = open(path)?;
    file.seek(SeekFrom::Start(offset)).map_err(LogError::Read)?;
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes).map_err(LogError::Read)?;
    Ok(bytes)
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
}
