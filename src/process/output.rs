//! Lines on standard output and stderr, and files that a command writes. What cannot be written is an error, except for a
//! reader that has gone, such as `head`: it ends a command that only prints, and nothing else.

use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::path::Path;
use std::process::exit;
use std::sync::OnceLock;

use anyhow::Context as _;

use crate::errors::Usage;
use crate::process::target::{Target, check_parent};

/// What a failed write to standard output means.
static STDOUT: OnceLock<Stdout> = OnceLock::new();
/// Why standard output could not be written, if that is an error.
static FAILURE: OnceLock<std::io::Error> = OnceLock::new();

/// Extensions of the files that commands write into folders.
const EXTENSIONS: [&str; 5] = ["csv", "onnx", "png", "svg", "xml"];

struct Stdout {
    effect: Effect,
    /// Every write to a terminal that was closed fails.
    is_terminal: bool,
}

/// What a command does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// It prints; without output it has nothing to do.
    Lines,
    /// It does more than print.
    Work,
}

/// Notes what the command does. Until then, and in tests, it counts as one that does more than print.
pub(crate) fn start(effect: Effect) {
    let is_terminal = std::io::stdout().is_terminal();
    STDOUT.get_or_init(|| Stdout { effect, is_terminal });
}

/// Writes the text and a line break. If that fails, a command that only prints ends: with status 0 if the reader has
/// gone, else with an error. Another command continues, and [`finish`] returns the error.
pub(crate) fn line(text: impl Display) {
    let mut stdout = std::io::stdout().lock();
    let written = writeln!(stdout, "{text}").and_then(|()| stdout.flush());
    drop(stdout);
    let Err(why) = written else { return };
    let stdout = STDOUT.get_or_init(|| Stdout { effect: Effect::Work, is_terminal: false });
    let gone = stdout.is_terminal || why.kind() == ErrorKind::BrokenPipe;
    match (stdout.effect, gone) {
        (Effect::Lines, true) => exit(0),
        (Effect::Lines, false) => {
            error(format!("error: {STDOUT_FAILED}: {why}"));
            exit(1)
        }
        (Effect::Work, true) => {}
        (Effect::Work, false) => drop(FAILURE.set(why)),
    }
}

const STDOUT_FAILED: &str = "cannot write to standard output";

/// Fails if a line could not be written.
pub(crate) fn finish() -> anyhow::Result<()> {
    match FAILURE.get() {
        Some(why) => Err(anyhow::anyhow!("{STDOUT_FAILED}: {why}")),
        None => Ok(()),
    }
}

/// The result of other output to standard output: a reader that has gone is no error.
pub(crate) fn written(result: std::io::Result<()>) -> anyhow::Result<()> {
    match result.and_then(|()| std::io::stdout().flush()) {
        Err(why) if why.kind() != ErrorKind::BrokenPipe => Err(why).context(STDOUT_FAILED),
        _ => Ok(()),
    }
}

/// Writes a line to stderr. Nothing can report that nobody reads it.
pub(crate) fn error(text: impl Display) {
    let _unread = writeln!(std::io::stderr().lock(), "{text}");
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
/// probably a misspelt path, or if it is a file or a new folder with the name of one.
pub(crate) fn option_folder(option: &str, path: &Path) -> anyhow::Result<()> {
    let refused = |why| Err(Usage::new(format!("{option} {}: {why}", path.display())).into());
    if path.is_file() {
        return refused("is a file; name a folder");
    }
    let is_named_file =
        path.extension().is_some_and(|found| EXTENSIONS.iter().any(|one| found == *one));
    if is_named_file && !path.exists() {
        return refused(
            "has the name of a file; name a folder, for the command writes several files",
        );
    }
    check_parent(option, path)?;
    folder(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_with_the_name_of_a_file_is_used_only_if_it_exists() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curves.svg");
        let refused = option_folder("--out", &path).unwrap_err().to_string();
        assert!(
            refused.ends_with("name a folder, for the command writes several files"),
            "{refused}"
        );
        std::fs::create_dir(&path).unwrap();
        option_folder("--out", &path).unwrap();
        option_folder("--out", &folder.path().join("figures.new")).unwrap();
    }
}
