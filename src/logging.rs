//! Log lines on stderr, as text or JSON, kept apart from a progress bar that stands on the same screen.

use std::io;
use std::sync::OnceLock;

use indicatif::MultiProgress;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer};

use crate::cli::{Arguments, Command, LogFormat};

/// The bars of this process; log lines are written above them.
static BARS: OnceLock<MultiProgress> = OnceLock::new();

/// The bars that log lines must not break.
pub(crate) fn bars() -> &'static MultiProgress {
    BARS.get_or_init(MultiProgress::new)
}

/// Starts logging; the filter is `--log`, then RUST_LOG, then the command's own level.
pub(crate) fn start(arguments: &Arguments) {
    let default = match arguments.command {
        Command::Learner(_) | Command::Actor(_) => "info",
        // A stranger at the live view's port is no trouble of the run's.
        _ => "warn,foxglove=off",
    };
    let filter = match &arguments.log {
        Some(filter) => EnvFilter::new(filter),
        None => EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default)),
    };
    let lines = tracing_subscriber::fmt::layer().with_writer(|| AboveBars);
    let lines = match arguments.log_format {
        LogFormat::Text => lines.with_ansi(false).with_target(false).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).boxed(),
    };
    tracing_subscriber::registry().with(lines.with_filter(filter)).init();
}

/// Writes to stderr while no bar is drawn.
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
