//! The process: its runtime, threads, stop signals, output and log lines.

pub(crate) mod output;
pub(crate) mod shell;
pub(crate) mod signals;
pub(crate) mod target;

use std::time::SystemTime;

use anyhow::Context as _;
use tokio::runtime::{Builder, Runtime};

/// Prepares the process for what the system may limit or stop.
pub(crate) fn prepare() -> anyhow::Result<()> {
    report_limit();
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

/// The beginnings of the panics of libraries that cannot start a thread: of tokio, of the standard library and of rayon.
const PANICS: [&str; 3] = [
    "OS can't spawn worker thread",
    "failed to spawn thread",
    "The global thread pool has not been initialized",
];

/// Reports such a panic, the sign of a limit of processes and threads, in one line. In the main thread it ends the program with status 1.
fn report_limit() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !panic.payload_as_str().is_some_and(is_limit) {
            return report(panic);
        }
        let advice = "raise the limit of processes and threads (`ulimit -u`, or the container's)";
        output::error(format!("error: cannot start a thread; {advice}"));
        if std::thread::current().name() == Some("main") {
            std::process::exit(1);
        }
    }));
}

fn is_limit(panic: &str) -> bool {
    PANICS.iter().any(|known| panic.starts_with(known))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_clock_before_1970_is_refused() {
        check_clock(SystemTime::UNIX_EPOCH).unwrap();
        let error = check_clock(SystemTime::UNIX_EPOCH - Duration::from_secs(1)).unwrap_err();
        assert!(error.to_string().contains("before 1970"), "{error}");
    }

    /// No address space has room for the stack of a thread.
    const STACK_BYTES: usize = 1 << 47;

    #[test]
    fn the_panic_of_a_runtime_that_gets_no_thread_is_known() {
        let start =
            || Builder::new_multi_thread().worker_threads(1).thread_stack_size(STACK_BYTES).build();
        let panic = std::panic::catch_unwind(start).unwrap_err();
        let text = panic.downcast_ref::<String>().unwrap();
        assert!(is_limit(text), "{text}");
    }
}
