//! Lines on standard output, and files that a command writes. A reader that has closed the pipe, such as `head`, must
//! neither stop a run nor cause a panic, so lines that cannot be written are dropped.

use std::fmt::Display;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;

use crate::errors::Usage;
use crate::process::target::{Target, check_parent};

/// Writes the text and a line break.
pub(crate) fn line(text: impl Display) {
    // The reader has closed the pipe.
    let _unread = writeln!(std::io::stdout().lock(), "{text}");
}

/// Writes or replaces a file with a fixed name in an existing folder.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    Target::fixed(path)?.write(bytes)
}

/// Creates a folder and its parents if necessary.
pub(crate) fn folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("cannot make {}", path.display()))
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
