//! Stop requests: the first Ctrl-C or SIGTERM ends a process cleanly, the second immediately with status 128 plus its
//! number. The end of the parent process is also a stop request.

use std::io::Read as _;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

/// What shells add to a signal's number to name a process that it ended.
const ENDED_BY_SIGNAL: i32 = 128;

/// Sets `stop` at the first signal, after `announce`; exits at the second. Call inside a runtime.
pub(crate) fn stop_on_signal(
    stop: watch::Sender<bool>,
    announce: impl FnOnce() + Send + 'static,
) -> anyhow::Result<()> {
    stop_on_repeated_signal(stop, Duration::ZERO, announce)
}

/// The same, but the signals that arrive within `repeated` after the first one are the same stop request.
pub(crate) fn stop_on_repeated_signal(
    stop: watch::Sender<bool>,
    repeated: Duration,
    announce: impl FnOnce() + Send + 'static,
) -> anyhow::Result<()> {
    let interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
    let terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
    tokio::spawn(watch_signals(stop, repeated, announce, interrupt, terminate));
    Ok(())
}

/// Sets `stop` when standard input closes. The pipe closes when the process at its other end ends, however that
/// happens.
pub(crate) fn stop_with_stdin(stop: watch::Sender<bool>) -> anyhow::Result<()> {
    let until_closed = move || {
        let mut ignored = [0; 256];
        while std::io::stdin().lock().read(&mut ignored).is_ok_and(|count| count > 0) {}
        stop.send_replace(true);
    };
    let watcher = std::thread::Builder::new().name("stdin".to_owned()).spawn(until_closed);
    // No thread waits for it; it ends with the process.
    watcher.map(drop).context("cannot watch standard input")
}

async fn watch_signals(
    stop: watch::Sender<bool>,
    repeated: Duration,
    announce: impl FnOnce(),
    mut interrupt: Signal,
    mut terminate: Signal,
) {
    either(&mut interrupt, &mut terminate).await;
    announce();
    stop.send_replace(true);
    let first = Instant::now();
    let mut second = either(&mut interrupt, &mut terminate).await;
    while first.elapsed() < repeated {
        second = either(&mut interrupt, &mut terminate).await;
    }
    std::process::exit(ENDED_BY_SIGNAL + second.as_raw_value());
}

/// The first of the two signals.
async fn either(interrupt: &mut Signal, terminate: &mut Signal) -> SignalKind {
    tokio::select! {
        _ = interrupt.recv() => SignalKind::interrupt(),
        _ = terminate.recv() => SignalKind::terminate(),
    }
}
