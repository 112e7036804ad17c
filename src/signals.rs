//! Ctrl-C and SIGTERM: the first asks for a clean end, the second ends the process at once, with 128 and its number
//! as the status.

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
    let interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
    let terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
    tokio::spawn(watch_signals(stop, announce, interrupt, terminate));
    Ok(())
}

async fn watch_signals(
    stop: watch::Sender<bool>,
    announce: impl FnOnce(),
    mut interrupt: Signal,
    mut terminate: Signal,
) {
    either(&mut interrupt, &mut terminate).await;
    announce();
    stop.send_replace(true);
    let second = either(&mut interrupt, &mut terminate).await;
    std::process::exit(ENDED_BY_SIGNAL + second.as_raw_value());
}

/// Which of the two came.
async fn either(interrupt: &mut Signal, terminate: &mut Signal) -> SignalKind {
    tokio::select! {
        _ = interrupt.recv() => SignalKind::interrupt(),
        _ = terminate.recv() => SignalKind::terminate(),
    }
}
