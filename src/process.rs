//! The process: its runtime, stop signals, output and log lines.

pub(crate) mod logging;
pub(crate) mod output;
pub(crate) mod runtime;
pub(crate) mod signals;
