//! What the Python module uses of this program: environments by the names and settings that commands take, and trained
//! teams.

mod agents;
mod environments;
mod teams;

pub use anyhow::{Error, Result};
pub use environments::{Environments, Picture};
pub use teams::{pretrained, trained};
use tracing_subscriber::filter::LevelFilter;

use crate::process::output::{self, LogFormat};

/// An error and its causes in one line, as commands print them.
pub fn line(error: &Error) -> String {
    actor::causes(error.as_ref())
}

/// Writes warnings to stderr from now on. Call it once.
///
/// # Errors
/// Never: no filter is given.
pub fn log_warnings() -> anyhow::Result<()> {
    Ok(output::start_log(LogFormat::Text, None, LevelFilter::WARN)?)
}
