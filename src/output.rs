//! Text on standard output, and files that a command was asked for. A reader that has left, such as `head`, must
//! neither stop a run nor end in a panic, so a line that cannot be written is dropped.

use std::error::Error;
use std::fmt::Display;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;

/// Writes one line (or several) and its end.
pub(crate) fn line(text: impl Display) {
    // Nobody reads any more; there is no one to tell.
    let _unread = writeln!(std::io::stdout().lock(), "{text}");
}

/// An error and its causes as one line; a cause that the text before it ends with is not told again.
pub(crate) fn chain<'a>(causes: impl Iterator<Item = &'a (dyn Error + 'static)>) -> String {
    let mut line = String::new();
    for cause in causes {
        let text = cause.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        if line.is_empty() {
            line = text;
        } else if !line.ends_with(&text) {
            line = format!("{line}: {text}");
        }
    }
    line
}

/// Writes a file, and makes its folder if there is none.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(Path::new(""));
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("cannot read a.toml: {source}")]
    struct Told {
        source: std::io::Error,
    }

    #[test]
    fn a_cause_that_is_told_already_is_told_once() {
        let denied = || std::io::Error::other("permission\n denied");
        let told = anyhow::Error::new(Told { source: denied() }).context("the run");
        assert_eq!(chain(told.chain()), "the run: cannot read a.toml: permission denied");
        let untold = anyhow::Error::new(denied()).context("cannot write b");
        assert_eq!(chain(untold.chain()), "cannot write b: permission denied");
    }
}
