//! Opens files only if they are plain files: a pipe would block, and in a run folder a link could lead out of it.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _};
use std::os::unix::fs::{FileTypeExt as _, OpenOptionsExt as _};
use std::path::Path;

/// Opens a plain file.
///
/// # Errors
/// If it cannot be opened, or is a link, a pipe or anything else that is not a plain file.
pub fn open(options: &OpenOptions, path: &Path) -> io::Result<File> {
    let mut options = options.clone();
    match options.custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path) {
        Ok(file) if file.metadata()?.is_file() => Ok(file),
        Ok(_) => Err(refusal(path).unwrap_or_else(|| io::ErrorKind::InvalidInput.into())),
        Err(error) => Err(refusal(path).unwrap_or(error)),
    }
}

/// Opens a plain file to append to it; creates it if it does not exist.
///
/// # Errors
/// As [`open`].
pub fn append(path: &Path) -> io::Result<File> {
    open(OpenOptions::new().create(true).append(true), path)
}

/// Opens a plain file to read it.
///
/// # Errors
/// As [`open`].
pub fn reader(path: &Path) -> io::Result<File> {
    open(OpenOptions::new().read(true), path)
}

/// Content of a plain file.
///
/// # Errors
/// As [`open`], or if it cannot be read.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    reader(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Content of a plain file; none if it does not exist.
///
/// # Errors
/// As [`read`].
pub(crate) fn read_if_present(path: &Path) -> io::Result<Vec<u8>> {
    match read(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        bytes => bytes,
    }
}

/// Text of a plain file.
///
/// # Errors
/// As [`read`], or if it is not UTF-8.
pub fn read_to_string(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    reader(path)?.read_to_string(&mut text)?;
    Ok(text)
}

/// Content of a plain file that the user names, of at most `limit` bytes. A link to such a file is followed.
///
/// # Errors
/// If it cannot be read, is larger, or is a pipe or anything else that is not a plain file.
pub fn named(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let whole = path.canonicalize()?;
    let mut bytes = Vec::new();
    reader(&whole)?.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        let why = format!("it has more than {limit} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, why));
    }
    Ok(bytes)
}

/// Text of a plain file that the user names, of at most `limit` bytes.
///
/// # Errors
/// As [`named`], or if it is not UTF-8.
pub fn named_text(path: &Path, limit: u64) -> io::Result<String> {
    let not_text = |_| io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8 text");
    String::from_utf8(named(path, limit)?).map_err(not_text)
}

/// The reason if something other than a plain file is at `path`.
#[must_use]
pub fn refusal(path: &Path) -> Option<io::Error> {
    let kind = path.symlink_metadata().ok()?.file_type();
    let word = match kind {
        _ if kind.is_file() => return None,
        _ if kind.is_symlink() => "a link",
        _ if kind.is_dir() => "a directory",
        _ if kind.is_fifo() => "a pipe",
        _ => "a device or socket",
    };
    Some(io::Error::new(io::ErrorKind::InvalidInput, format!("it is {word}, not a plain file")))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn pipes_are_not_waited_for_and_links_are_followed_only_where_the_user_names_them() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, pipe] = ["file", "link", "pipe"].map(|name| folder.path().join(name));
        std::fs::write(&file, "a").unwrap();
        symlink(&file, &link).unwrap();
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        assert_eq!(read_to_string(&file).unwrap(), "a");
        for (path, kind) in [(&link, "a link"), (&pipe, "a pipe")] {
            for error in [read(path).unwrap_err(), append(path).unwrap_err()] {
                assert_eq!(error.to_string(), format!("it is {kind}, not a plain file"));
            }
        }
        assert_eq!(named_text(&link, 1).unwrap(), "a");
        assert_eq!(named(&link, 0).unwrap_err().to_string(), "it has more than 0 bytes");
        assert_eq!(named(&pipe, 1).unwrap_err().to_string(), "it is a pipe, not a plain file");
        let none = named(&folder.path().join("none"), 1).unwrap_err();
        assert_eq!(none.kind(), io::ErrorKind::NotFound);
        assert_eq!(read(&folder.path().join("none")).unwrap_err().kind(), io::ErrorKind::NotFound);
    }
}
