//! The process: its runtime, stop signals, output and log lines.

pub(crate) mod home;
pub(crate) mod logging;
pub(crate) mod output;
pub(crate) mod shell;
pub(crate) mod signals;
pub(crate) mod target;

use anyhow::Context as _;
use tokio::runtime::{Builder, Runtime};

/// Starts the threads for sockets, signals and child processes; stepping and training have their own.
pub(crate) fn runtime() -> anyhow::Result<Runtime> {
    Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("network")
        .enable_all()
        .build()
        .context("cannot start the network threads")
}
