//! The process: its runtime, threads, stop signals, output and log lines.

pub(crate) mod home;
pub(crate) mod logging;
pub(crate) mod output;
pub(crate) mod shell;
pub(crate) mod signals;
pub(crate) mod target;
pub(crate) mod threads;

use std::time::SystemTime;

use anyhow::Context as _;
use tokio::runtime::{Builder, Runtime};

/// Prepares the process for what the system may limit or stop.
pub(crate) fn prepare() -> anyhow::Result<()> {
    threads::report_limit();
    check_clock(SystemTime::now())?;
    signals::survive_file_size_limit()
}

/// Refuses a time before 1970, which HTTP and TLS cannot express: their libraries panic.
fn check_clock(now: SystemTime) -> anyhow::Result<()> {
    let valid = now >= SystemTime::UNIX_EPOCH;
    anyhow::ensure!(valid, "the clock of this machine is before 1970; set it");
    Ok(())
}

/// Starts the threads for sockets, signals and child processes; stepping and training have their own.
pub(crate) fn runtime() -> anyhow::Result<Runtime> {
    Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("network")
        .enable_all()
        .build()
        .context("cannot start the network threads")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_clock_before_1970_is_refused() {
        check_clock(SystemTime::UNIX_EPOCH).unwrap();
        let error = check_clock(SystemTime::UNIX_EPOCH - Duration::from_secs(1)).unwrap_err();
        assert!(error.to_string().contains("before 1970"), "{error}");
    }
}
