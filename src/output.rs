//! Text on standard output, and files that a command was asked for. A reader that has left, such as `head`, must
//! neither stop a run nor end in a panic, so a line that cannot be written is dropped.

use std::fmt::Display;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;

/// Writes one line (or several) and its end.
pub(crate) fn line(text: impl Display) {
    // Nobody reads any more; there is no one to tell.
    let _unread = writeln!(std::io::stdout().lock(), "{text}");
}

/// Writes a file, and makes its folder if there is none.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(Path::new(""));
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
