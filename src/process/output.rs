//! Lines on standard output and stderr, log lines, and the progress bars below them. What cannot be written is an error,
//! except for a reader that has gone, such as `head`: it ends a command that only prints, and nothing else.

use std::fmt::Display;
use std::io::{self, ErrorKind, IsTerminal as _, Write as _};
use std::process::exit;
use std::sync::OnceLock;

use anyhow::Context as _;
use clap::ValueEnum;
use indicatif::MultiProgress;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::errors::Usage;

/// What a failed write to standard output means.
static STDOUT: OnceLock<Stdout> = OnceLock::new();
/// Why standard output could not be written, if that is an error.
static FAILURE: OnceLock<io::Error> = OnceLock::new();

struct Stdout {
    kind: CommandKind,
    /// Every write to a terminal that was closed fails.
    is_terminal: bool,
}

/// What a command does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CommandKind {
    /// It prints; without output it has nothing to do.
    Lines,
    /// It does more than print.
    Work,
}

/// Notes what the command does. Until then, and in tests, it counts as one that does more than print.
pub(crate) fn start(kind: CommandKind) {
    let is_terminal = io::stdout().is_terminal();
    STDOUT.get_or_init(|| Stdout { kind, is_terminal });
}

/// Writes the text and a line break. If that fails, a command that only prints ends: with status 0 if the reader has
/// gone, else with an error. Another command continues, and [`finish`] returns the error.
pub(crate) fn line(text: impl Display) {
    let mut stdout = io::stdout().lock();
    let written = writeln!(stdout, "{text}").and_then(|()| stdout.flush());
    drop(stdout);
    let Err(why) = written else { return };
    let stdout = STDOUT.get_or_init(|| Stdout { kind: CommandKind::Work, is_terminal: false });
    let gone = stdout.is_terminal || why.kind() == ErrorKind::BrokenPipe;
    match (stdout.kind, gone) {
        (CommandKind::Lines, true) => exit(0),
        (CommandKind::Lines, false) => {
            error(format!("error: {STDOUT_FAILED}: {why}"));
            exit(1)
        }
        (CommandKind::Work, true) => {}
        (CommandKind::Work, false) => drop(FAILURE.set(why)),
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
pub(crate) fn written(result: io::Result<()>) -> anyhow::Result<()> {
    match result.and_then(|()| io::stdout().flush()) {
        Err(why) if why.kind() != ErrorKind::BrokenPipe => Err(why).context(STDOUT_FAILED),
        _ => Ok(()),
    }
}

/// Writes a line to stderr. A failure cannot be reported.
pub(crate) fn error(text: impl Display) {
    let _unread = writeln!(io::stderr().lock(), "{text}");
}

/// The bars of this process; log lines are written above them.
static BARS: OnceLock<MultiProgress> = OnceLock::new();

/// The progress bars of this process.
pub(crate) fn bars() -> &'static MultiProgress {
    BARS.get_or_init(MultiProgress::new)
}

/// Log format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// Human-readable lines.
    Text,
    /// One JSON object per line.
    Json,
}

/// Starts logging with the filter `given` by `--log`, else that of RUST_LOG, else `default`.
///
/// # Errors
/// The filter of `--log` is invalid.
pub(crate) fn start_log(
    format: LogFormat,
    given: Option<&str>,
    default: LevelFilter,
) -> Result<(), Usage> {
    let filter: Targets = match given {
        Some(filter) => {
            filter.parse().map_err(|error| Usage::new(format!("--log {filter}: {error}")))?
        }
        None => {
            let variable = std::env::var("RUST_LOG").ok();
            let filter = variable.and_then(|filter| filter.parse().ok());
            filter.unwrap_or_else(|| Targets::new().with_default(default))
        }
    };
    // A failed write to stderr must not be reported on the same stderr, which would panic.
    let lines = tracing_subscriber::fmt::layer().with_writer(|| AboveBars);
    let lines = lines.log_internal_errors(false);
    let lines = match format {
        LogFormat::Text => lines.with_target(false).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).boxed(),
    };
    tracing_subscriber::registry().with(lines.with_filter(filter)).init();
    Ok(())
}

/// Writes to stderr with the bars suspended.
struct AboveBars;

impl io::Write for AboveBars {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        match BARS.get() {
            Some(bars) => bars.suspend(|| io::stderr().write(line)),
            None => io::stderr().write(line),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
