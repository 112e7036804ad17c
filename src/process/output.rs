//! Lines on standard output, and files that a command writes. A reader that has closed the pipe, such as `head`, must
//! neither stop a run nor cause a panic, so lines that cannot be written are dropped.

use std::fmt::Display;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;

use crate::errors::Usage;

/// Writes the text and a line break.
pub(crate) fn line(text: impl Display) {
    // The reader has closed the pipe.
    let _unread = writeln!(std::io::stdout().lock(), "{text}");
}

/// Writes a file into an existing folder.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Creates a folder and its parents if necessary.
pub(crate) fn folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("cannot make {}", path.display()))
}

/// Refuses a file that `option` names if its folder does not exist, or if it is a folder itself.
pub(crate) fn check_file(option: &str, path: &Path) -> Result<(), Usage> {
    if path.is_dir() {
        return Err(Usage::new(format!("{option} {}: is a folder; name a file", path.display())));
    }
    check_parent(option, path)
}

/// Creates the folder that `option` names, if necessary. Refuses it if the folder around it does not exist, which is
/// probably a misspelt path, or if it is a file.
pub(crate) fn option_folder(option: &str, path: &Path) -> anyhow::Result<()> {
    if path.is_file() {
        let why = format!("{option} {}: is a file; name a folder", path.display());
        return Err(Usage::new(why).into());
    }
    check_parent(option, path)?;
    folder(path)
}

fn check_parent(option: &str, path: &Path) -> Result<(), Usage> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    match parent.filter(|parent| !parent.is_dir()) {
        None => Ok(()),
        Some(parent) => Err(Usage::new(format!(
            "{option} {}: there is no folder {}; create it first",
            path.display(),
            parent.display()
        ))),
    }
}
