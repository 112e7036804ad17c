//! Stop requests: the first Ctrl-C, SIGTERM or SIGHUP ends a process cleanly, the second Ctrl-C or SIGTERM immediately with
//! status 128 plus its number. The end of the parent process is also a stop request.

use std::io::Read as _;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use tokio::runtime::Builder;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

/// What shells add to a signal's number to name a process that it ended.
const ENDED_BY_SIGNAL: i32 = 128;

/// The number of SIGXFSZ, the same on Linux, macOS and the BSDs for x86 and ARM.
const FILE_SIZE: i32 = 25;

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
    let requests = Requests::listen()?;
    tokio::spawn(requests.watch(stop, repeated, announce));
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

/// Makes a write past a limit of file sizes (`ulimit -f`) an error, as on a full disk. By default SIGXFSZ ends the process.
pub(crate) fn survive_file_size_limit() -> anyhow::Result<()> {
    let runtime = Builder::new_current_thread().enable_io().build();
    let runtime = runtime.context("cannot listen for signals")?;
    let _entered = runtime.enter();
    // Its handler remains until the process ends.
    signal(SignalKind::from_raw(FILE_SIZE)).map(drop).context("cannot listen for SIGXFSZ")
}

/// The signals that ask a process to stop.
struct Requests {
    interrupt: Signal,
    terminate: Signal,
    /// `None` if SIGHUP is ignored, as `nohup` has it.
    hang_up: Option<Signal>,
}

impl Requests {
    fn listen() -> anyhow::Result<Self> {
        let hang_up = if is_ignored(SignalKind::hangup()) {
            None
        } else {
            Some(signal(SignalKind::hangup()).context("cannot listen for SIGHUP")?)
        };
        Ok(Self {
            interrupt: signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?,
            terminate: signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?,
            hang_up,
        })
    }

    async fn watch(
        mut self,
        stop: watch::Sender<bool>,
        repeated: Duration,
        announce: impl FnOnce(),
    ) {
        let kind = self.first().await;
        announce();
        stop.send_replace(true);
        if kind == SignalKind::hangup() {
            // A session that ends sends SIGHUP more than once, and SIGTERM besides.
            self.repeated().await;
        }
        let first = Instant::now();
        let mut second = self.repeated().await;
        while first.elapsed() < repeated {
            second = self.repeated().await;
        }
        std::process::exit(ENDED_BY_SIGNAL + second.as_raw_value());
    }

    /// The next of the three signals.
    async fn first(&mut self) -> SignalKind {
        let hung_up = async {
            match &mut self.hang_up {
                Some(signal) => signal.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = self.interrupt.recv() => SignalKind::interrupt(),
            _ = self.terminate.recv() => SignalKind::terminate(),
            _ = hung_up => SignalKind::hangup(),
        }
    }

    /// The next of the two signals that may end the process at once.
    async fn repeated(&mut self) -> SignalKind {
        tokio::select! {
            _ = self.interrupt.recv() => SignalKind::interrupt(),
            _ = self.terminate.recv() => SignalKind::terminate(),
        }
    }
}

/// Whether the process was started with this signal ignored; only Linux tells.
fn is_ignored(kind: SignalKind) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask & (1 << (kind.as_raw_value() - 1)) != 0
}
