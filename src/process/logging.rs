//! Log lines on stderr, as text or JSON, printed above the progress bars.

use std::io;
use std::sync::OnceLock;

use clap::ValueEnum;
use indicatif::MultiProgress;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::errors::Usage;

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
pub(crate) fn start(
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
    // A line that nobody reads must not be reported on the same stderr, which would panic.
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
