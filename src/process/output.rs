//! Lines on standard output, and files that a command writes. A reader that has closed the pipe, such as `head`, must
//! neither stop a run nor cause a panic, so lines that cannot be written are dropped.

use std::fmt::Display;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;

/// Writes the text and a line break.
pub(crate) fn line(text: impl Display) {
    // The reader has closed the pipe.
    let _unread = writeln!(std::io::stdout().lock(), "{text}");
}

/// Writes a file and creates its folder if necessary.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    folder(path.parent().unwrap_or(Path::new("")))?;
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Creates a folder and its parents if necessary.
pub(crate) fn folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("cannot make {}", path.display()))
}
