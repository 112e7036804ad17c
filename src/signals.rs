//! Ctrl-C and SIGTERM: the first asks for a clean end, the second ends the process at once.

use anyhow::Context as _;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

/// Exit status of a process ended by the second signal, as shells give it for Ctrl-C.
const ENDED_BY_SIGNAL: i32 = 130;

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
    either(&mut interrupt, &mut terminate).await;
    std::process::exit(ENDED_BY_SIGNAL);
}

async fn either(interrupt: &mut Signal, terminate: &mut Signal) {
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
}
