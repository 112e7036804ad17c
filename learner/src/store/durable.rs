//! Files that survive a crash and a power cut: written beside their place, flushed, then renamed.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read as _, Write as _};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use crate::store::plain_file;

/// With what the name of a file or folder begins until it is complete.
pub(crate) const DRAFT: &str = ".tmp-";

/// Permissions of a file; the process's umask may take some away.
const ANYONE: u32 = 0o666;
/// Permissions of a file that only its owner can read and write.
const OWNER_ONLY: u32 = 0o600;

/// A file that could not be written or read.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {path}: {source}")]
pub struct FileError {
    /// What was tried.
    pub action: &'static str,
    /// The file or folder.
    pub path: PathBuf,
    /// Why it failed.
    pub source: io::Error,
}

impl FileError {
    /// For `map_err`: names the action and the path.
    pub(crate) fn of(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self { action, path, source }
    }
}

/// Writes a whole new file and waits until the disk has it. What is at the path is removed first, never written through.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_for(ANYONE, path, bytes)
}

fn write_for(mode: u32, path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let mut file = create(mode, path)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all());
    written.map_err(FileError::of("write", path))
}

/// A new, empty file. What is at the path is removed first, never written through.
fn create(mode: u32, path: &Path) -> Result<File, FileError> {
    remove_file(path)?;
    let created = OpenOptions::new().write(true).create_new(true).mode(mode).open(path);
    created.map_err(FileError::of("write", path))
}

/// As [`write`], with the bytes that `content` writes.
pub(crate) fn write_by<T, E: From<FileError>>(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<File>) -> Result<T, E>,
) -> Result<T, E> {
    let mut file = BufWriter::new(create(ANYONE, path)?);
    let written = content(&mut file)?;
    let flushed = file.flush().and_then(|()| file.get_ref().sync_all());
    flushed.map_err(FileError::of("write", path))?;
    Ok(written)
}

/// Waits until the disk has the folder's entries.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), FileError> {
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(FileError::of("flush", folder))
}

/// Replaces a file as a whole: a reader sees the old one or the new one, never a part.
///
/// # Errors
/// Names the file or folder that could not be written.
pub fn replace(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    replace_for(ANYONE, path, bytes)
}

/// As [`replace`], with a file that only its owner can read.
///
/// # Errors
/// As [`replace`].
pub fn replace_private(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    replace_for(OWNER_ONLY, path, bytes)
}

fn replace_for(mode: u32, path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let name =
        path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let draft = path.with_file_name(format!("{DRAFT}{name}"));
    let renamed = || std::fs::rename(&draft, path).map_err(FileError::of("replace", path));
    write_for(mode, &draft, bytes).and_then(|()| renamed()).inspect_err(|_| {
        // A part must not keep space on a full disk.
        let _gone = std::fs::remove_file(&draft);
    })?;
    sync_name(path)
}

/// Appends a line to a file, which is created if it does not exist, and waits until the disk has it. Half a line that a crash
/// left is dropped.
pub(crate) fn append_line(path: &Path, line: &str) -> Result<(), FileError> {
    let appended = plain_file::open(OpenOptions::new().create(true).read(true).append(true), path);
    let appended = appended.and_then(|mut file| {
        let mut text = Vec::new();
        file.read_to_end(&mut text)?;
        file.set_len(whole_lines(&text) as u64)?;
        file.write_all(format!("{line}\n").as_bytes())?;
        file.sync_all()
    });
    appended.map_err(FileError::of("write", path))?;
    sync_name(path)
}

/// Adds bytes that a repair drops from a damaged file to `NAME.damaged` beside it, unless it ends with them, and returns that
/// path.
///
/// # Errors
/// Names the file or folder that could not be written.
pub fn keep_damaged(path: &Path, bytes: &[u8]) -> Result<PathBuf, FileError> {
    let mut name = path.as_os_str().to_owned();
    name.push(".damaged");
    let kept = PathBuf::from(name);
    if plain_file::read(&kept).is_ok_and(|earlier| earlier.ends_with(bytes)) {
        return Ok(kept);
    }
    let appended = plain_file::append(&kept).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    appended.map_err(FileError::of("write", &kept))?;
    sync_name(&kept)?;
    Ok(kept)
}

/// Number of bytes up to the end of the last whole line.
pub(crate) fn whole_lines(text: &[u8]) -> usize {
    text.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1)
}

/// Creates a folder and its parents if they do not exist, and waits until the disk has the names of all that are new.
///
/// # Errors
/// Names the folder that could not be made or flushed.
pub fn make_folder(folder: &Path) -> Result<(), FileError> {
    let is_new = |one: &&Path| !one.as_os_str().is_empty() && !one.is_dir();
    let new = folder.ancestors().take_while(is_new).collect::<Vec<_>>();
    let made = std::fs::create_dir_all(folder);
    made.map_err(|why| FileError::of("make", folder)(broken_link(folder).unwrap_or(why)))?;
    new.into_iter().rev().try_for_each(sync_name)
}

/// The reason why `path` cannot be made, if a part of it is a link to nothing.
pub(crate) fn broken_link(path: &Path) -> Option<io::Error> {
    let link = path.ancestors().find(|part| part.is_symlink() && !exists(part))?;
    let (link, target) = (link.display(), link.read_link().ok()?);
    let why = format!("{link} is a link to {}, which does not exist", target.display());
    Some(io::Error::new(io::ErrorKind::NotFound, why))
}

/// Waits until the disk has the name of a file or folder.
pub(crate) fn sync_name(path: &Path) -> Result<(), FileError> {
    let named = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    sync_folder(named.unwrap_or(Path::new(".")))
}

/// Whether `path` leads to the open file or folder. Only a path that leads nowhere or elsewhere does not: one that
/// cannot be looked at fails when it is written.
pub(crate) fn leads_to(path: &Path, open: &File) -> bool {
    match (std::fs::metadata(path), open.metadata()) {
        (Ok(found), Ok(own)) => (found.dev(), found.ino()) == (own.dev(), own.ino()),
        (Err(error), _) => !is_absent(&error),
        _ => true,
    }
}

/// Whether `path` exists; true if that is unknown.
pub(crate) fn exists(path: &Path) -> bool {
    std::fs::metadata(path).map_or_else(|error| !is_absent(&error), |_| true)
}

fn is_absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

/// Removes a file, if it is there.
pub(crate) fn remove_file(path: &Path) -> Result<(), FileError> {
    unless_absent(std::fs::remove_file(path)).map_err(FileError::of("remove", path))
}

/// Removes a folder with everything in it, if it is there.
pub(crate) fn remove_folder(folder: &Path) -> Result<(), FileError> {
    unless_absent(std::fs::remove_dir_all(folder)).map_err(FileError::of("remove", folder))
}

fn unless_absent(removed: io::Result<()>) -> io::Result<()> {
    match removed {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_cannot_be_replaced_leaves_no_draft() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        std::fs::create_dir(&taken).unwrap();
        assert!(replace(&taken, b"new").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
