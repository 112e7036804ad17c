//! Text on standard output. A reader that has left, such as `head`, must neither stop a run nor end in a
//! panic, so what cannot be written is dropped.

use std::fmt::Display;
use std::io::Write as _;

/// Writes one line (or several) and its end.
pub(crate) fn line(text: impl Display) {
    // Nobody reads any more; there is no one to tell.
    let _unread = writeln!(std::io::stdout().lock(), "{text}");
}
