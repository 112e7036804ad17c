//! Why a child process failed, from its exit status and the part of the log that it wrote.

use std::io::{Read as _, Seek as _, SeekFrom};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;

use learner::store::plain_file;

/// Levels of log lines that report no failure.
const HARMLESS: [&str; 4] = ["WARN", "INFO", "DEBUG", "TRACE"];

/// Start of the line that follows the message of a panic.
const BACKTRACE: &str = "note: run with `RUST_BACKTRACE";

/// Signal of `abort`, which follows an error message.
const ABORTED: i32 = 6;

/// The log that a process appends to, and its length when the process started.
pub(crate) struct ProcessLog {
    path: PathBuf,
    from: u64,
}

impl ProcessLog {
    /// Notes the length of the log before the process starts.
    pub(crate) fn before_start(path: &Path) -> Self {
        let from = path.metadata().map_or(0, |found| found.len());
        Self { path: path.to_path_buf(), from }
    }

    /// The exit status, with the last error that the process reported. A process that a signal killed had no chance to
    /// report its cause.
    pub(crate) fn cause(&self, status: ExitStatus) -> String {
        let killed = status.signal().is_some_and(|signal| signal != ABORTED);
        match self.error().filter(|_| !killed) {
            Some(error) => format!("{status}: {error}"),
            None => status.to_string(),
        }
    }

    /// The last line that is neither blank nor a log line of a harmless level.
    fn error(&self) -> Option<String> {
        let mut file = plain_file::reader(&self.path).ok()?;
        file.seek(SeekFrom::Start(self.from)).ok()?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).ok()?;
        let text = String::from_utf8_lossy(&bytes);
        let is_error = |line: &&str| !line.trim().is_empty() && !is_harmless(line);
        text.lines().rev().find(is_error).map(|line| line.trim().to_owned())
    }
}

/// Whether a line is a log line, `TIME LEVEL MESSAGE`, of a level that reports no failure, or the advice after a panic.
fn is_harmless(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let dated = words.next().is_some_and(|time| time.ends_with('Z') && time.contains('T'));
    let harmless = dated && words.next().is_some_and(|level| HARMLESS.contains(&level));
    harmless || line.starts_with(BACKTRACE)
}

#[cfg(test)]
mod tests {
    use super::*;

    const EARLIER: &str = "error: an earlier process\n";
    const INFO: &str = "2026-01-31T23:59:59.123456Z  INFO registered with the learner run=a\n";
    const ERROR: &str = "2026-01-31T23:59:59.123456Z ERROR the weights are damaged\n";

    /// The cause of a process that ended with the wait status `raw` and appended `text` to its log.
    fn cause(text: &str, raw: i32) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("actor_0.log");
        std::fs::write(&path, EARLIER).unwrap();
        let own_log = ProcessLog::before_start(&path);
        std::fs::write(&path, format!("{EARLIER}{text}")).unwrap();
        own_log.cause(ExitStatus::from_raw(raw))
    }

    #[test]
    fn the_cause_is_the_signal_or_the_last_error_or_panic_of_the_process_itself_or_its_status() {
        let panic = "thread 'step' panicked at src/a.rs:1:1:\nno slot 3\n\
                     note: run with `RUST_BACKTRACE=1` environment variable to display a backtrace\n";
        for (text, raw, expected) in [
            (format!("{ERROR}{INFO}"), 1 << 8, format!("exit status: 1: {}", ERROR.trim())),
            (format!("{INFO}error: no task\n\n"), 2 << 8, "exit status: 2: error: no task".into()),
            (panic.to_owned(), 101 << 8, "exit status: 101: no slot 3".into()),
            (INFO.to_owned(), 1 << 8, "exit status: 1".into()),
            (String::new(), 1 << 8, "exit status: 1".into()),
            (format!("{ERROR}{INFO}"), 9, "signal: 9 (SIGKILL)".into()),
            (
                format!("{INFO}memory allocation of 8 bytes failed\n"),
                ABORTED,
                "signal: 6 (SIGABRT): memory allocation of 8 bytes failed".into(),
            ),
        ] {
            assert_eq!(cause(&text, raw), expected);
        }
    }
}
