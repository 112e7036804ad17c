//! This process: its runtime, threads, limits, output and log lines; the stop requests that end it; and why a child process
//! failed.
//!
//! The first Ctrl-C, SIGTERM or SIGHUP ends a process cleanly, the second Ctrl-C or SIGTERM immediately with status 128 plus its
//! number. The end of the parent process is also a stop request.

pub(crate) mod output;
pub(crate) mod shell;
pub(crate) mod target;

use std::io::{Read as _, Seek as _, SeekFrom};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context as _;
use learner::store::plain_file;
use tokio::process::{Child, Command};
use tokio::runtime::{Builder, Runtime};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

/// The beginnings of the panics of libraries that cannot start a thread: of tokio, of the standard library and of rayon.
const PANICS: [&str; 3] = [
    "OS can't spawn worker thread",
    "failed to spawn thread",
    "The global thread pool has not been initialized",
];

/// What shells add to a signal's number to name a process that it ended.
const ENDED_BY_SIGNAL: i32 = 128;

/// The number of SIGXFSZ, the same on Linux, macOS and the BSDs for x86 and ARM.
const FILE_SIZE: i32 = 25;

/// Levels of log lines that report no failure.
const HARMLESS: [&str; 4] = ["WARN", "INFO", "DEBUG", "TRACE"];

/// Start of the line that follows the message of a panic.
const BACKTRACE: &str = "note: run with `RUST_BACKTRACE";

/// Signal of `abort`, which follows an error message.
const ABORTED: i32 = 6;

/// Prepares the process for what the system may limit or stop.
pub(crate) fn prepare() -> anyhow::Result<()> {
    report_limit();
    check_clock(SystemTime::now())?;
    survive_file_size_limit()
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

/// Signals within this time are one stop request: `timeout` signals a process and then its group, to which it belongs.
pub(crate) const SIGNAL_WINDOW: Duration = Duration::from_millis(500);

/// Sets `stop` at the first signal, after `announce`; exits at the second. Call inside a runtime.
pub(crate) fn stop_on_signal(
    stop: watch::Sender<bool>,
    announce: impl FnOnce() + Send + 'static,
) -> anyhow::Result<()> {
    stop_or_exit(stop, SIGNAL_WINDOW, announce, || ())
}

/// The same, with `clean_up` before the exit. Signals within `window` after the first one are the same stop request.
pub(crate) fn stop_or_exit(
    stop: watch::Sender<bool>,
    window: Duration,
    announce: impl FnOnce() + Send + 'static,
    clean_up: impl FnOnce() + Send + 'static,
) -> anyhow::Result<()> {
    let mut requests = Requests::listen()?;
    tokio::spawn(async move {
        let kind = requests.first().await;
        announce();
        stop.send_replace(true);
        if kind == SignalKind::hangup() {
            // A session that ends sends SIGHUP more than once, and SIGTERM besides.
            requests.next_exit().await;
        }
        let signal = requests.second(window).await;
        clean_up();
        std::process::exit(ENDED_BY_SIGNAL + signal.as_raw_value());
    });
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

/// Starts a process in a group of its own, so that Ctrl-C reaches it only through its standard input, whose end is a stop
/// request.
pub(crate) fn start(command: &mut Command) -> anyhow::Result<Child> {
    let started = command.stdin(Stdio::piped()).process_group(0).spawn();
    started.with_context(|| format!("cannot start {}", command.as_std().get_program().display()))
}

/// Waits for a process that [`start`] started. Closes its standard input when `stop` is ready, and returns `None` then.
pub(crate) async fn until_exit(
    child: &mut Child,
    stop: impl Future<Output = ()>,
) -> Option<std::io::Result<ExitStatus>> {
    // `Child::wait` would close the pipe at once.
    let stdin = child.stdin.take();
    tokio::select! {
        status = child.wait() => Some(status),
        () = stop => {
            drop(stdin);
            None
        }
    }
}

/// The log that a process appends to, and its length when the process started.
pub(crate) struct ProcessLog {
    path: PathBuf,
    from: u64,
}

impl ProcessLog {
    /// Notes the length of the log before the process starts.
    pub(crate) fn before_start(path: &Path) -> Self {
        let from = path.metadata().map_or(0, |found| found.len());
        Self { path: path.to_path_buf(), from }
    }

    /// The exit status, with the last error that the process reported. A process that a signal killed had no chance to
    /// report its cause.
    pub(crate) fn cause(&self, status: ExitStatus) -> String {
        let killed = status.signal().is_some_and(|signal| signal != ABORTED);
        match self.error().filter(|_| !killed) {
            Some(error) => format!("{status}: {error}"),
            None => status.to_string(),
        }
    }

    /// The last line that is neither blank nor a log line of a harmless level.
    fn error(&self) -> Option<String> {
        let mut file = plain_file::reader(&self.path).ok()?;
        file.seek(SeekFrom::Start(self.from)).ok()?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).ok()?;
        let text = String::from_utf8_lossy(&bytes);
        let is_error = |line: &&str| !line.trim().is_empty() && !is_harmless(line);
        text.lines().rev().find(is_error).map(|line| line.trim().to_owned())
    }
}

/// Refuses a time before 1970, which HTTP and TLS cannot express: their libraries panic.
fn check_clock(now: SystemTime) -> anyhow::Result<()> {
    let valid = now >= SystemTime::UNIX_EPOCH;
    anyhow::ensure!(valid, "the clock of this machine is before 1970; set it");
    Ok(())
}

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

/// Makes a write past a limit of file sizes (`ulimit -f`) an error, as on a full disk. By default SIGXFSZ ends the process.
fn survive_file_size_limit() -> anyhow::Result<()> {
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

    /// The signal that ends the process at once: the first that comes later than `window` after the stop request.
    async fn second(&mut self, window: Duration) -> SignalKind {
        let first = Instant::now();
        let mut second = self.next_exit().await;
        while first.elapsed() < window {
            second = self.next_exit().await;
        }
        second
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
    async fn next_exit(&mut self) -> SignalKind {
        tokio::select! {
            _ = self.interrupt.recv() => SignalKind::interrupt(),
            _ = self.terminate.recv() => SignalKind::terminate(),
        }
    }
}

/// Whether the process was started with this signal ignored. Where the system has no `/proc`, a shell, which inherits
/// that, tests it.
fn is_ignored(kind: SignalKind) -> bool {
    let Ok(status) = std::fs::read_to_string("/proc/self/status") else {
        return survives(&mut std::process::Command::new("sh"), kind);
    };
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask & (1 << (kind.as_raw_value() - 1)) != 0
}

/// Whether a shell continues after it sends itself a signal.
fn survives(shell: &mut std::process::Command, kind: SignalKind) -> bool {
    let script = format!("kill -{} $$", kind.as_raw_value());
    shell.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    shell.args(["-c", &script]).status().is_ok_and(|status| status.success())
}

/// Whether a line is a log line, `TIME LEVEL MESSAGE`, of a level that reports no failure, or the advice after a panic.
fn is_harmless(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let dated = words.next().is_some_and(|time| time.ends_with('Z') && time.contains('T'));
    let harmless = dated && words.next().is_some_and(|level| HARMLESS.contains(&level));
    harmless || line.starts_with(BACKTRACE)
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

    #[test]
    fn a_shell_survives_a_signal_that_it_was_started_to_ignore_and_no_other() {
        let under_nohup = || {
            let mut command = std::process::Command::new("nohup");
            command.arg("sh");
            command
        };
        assert!(survives(&mut under_nohup(), SignalKind::hangup()));
        assert!(!survives(&mut under_nohup(), SignalKind::user_defined1()));
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

    const EARLIER: &str = "error: an earlier process\n";
    const INFO: &str = "2026-01-31T23:59:59.123456Z  INFO registered with the learner run=a\n";
    const ERROR: &str = "2026-01-31T23:59:59.123456Z ERROR the weights are damaged\n";

    /// The cause of a process that ended with the wait status `raw` and appended `text` to its log.
    fn cause(text: &str, raw: i32) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("actor_0.log");
        std::fs::write(&path, EARLIER).unwrap();
        let own_log = ProcessLog::before_start(&path);
        std::fs::write(&path, format!("{EARLIER}{text}")).unwrap();
        own_log.cause(ExitStatus::from_raw(raw))
    }

    #[test]
    fn the_cause_is_the_signal_or_the_last_error_or_panic_of_the_process_itself_or_its_status() {
        let panic = "thread 'step' panicked at src/a.rs:1:1:\nno slot 3\n\
                     note: run with `RUST_BACKTRACE=1` environment variable to display a backtrace\n";
        for (text, raw, expected) in [
            (format!("{ERROR}{INFO}"), 1 << 8, format!("exit status: 1: {}", ERROR.trim())),
            (format!("{INFO}error: no task\n\n"), 2 << 8, "exit status: 2: error: no task".into()),
            (panic.to_owned(), 101 << 8, "exit status: 101: no slot 3".into()),
            (INFO.to_owned(), 1 << 8, "exit status: 1".into()),
            (String::new(), 1 << 8, "exit status: 1".into()),
            (format!("{ERROR}{INFO}"), 9, "signal: 9 (SIGKILL)".into()),
            (
                format!("{INFO}memory allocation of 8 bytes failed\n"),
                ABORTED,
                "signal: 6 (SIGABRT): memory allocation of 8 bytes failed".into(),
            ),
        ] {
            assert_eq!(cause(&text, raw), expected);
        }
    }
}
