//! Runs an experiment's trainings, several at once, each in its own process: starts new ones, resumes stopped ones,
//! skips finished ones. A run that fails does not stop the others.

use std::collections::VecDeque;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use anyhow::Context as _;
use learner::store::plain_file;
use tokio::process::{Child, Command};
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::plan::PlannedRun;
use super::progress::ExperimentProgress;
use super::run_state::{Ending, RunFolderState, is_finished, mismatch, run_state};
use crate::run::process_log::ProcessLog;

/// Poll interval for the progress of runs and for a locked log.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

/// Numbers of runs by how they ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    /// Finished runs, including those that were finished before.
    pub(crate) finished: usize,
    /// Failed runs.
    pub(crate) failed: usize,
    /// Runs whose folders hold other runs.
    pub(crate) misplaced: usize,
}

/// Runs all to their end, at most `at_once` at a time, or stops them with checkpoints.
pub(crate) async fn run_all(
    runs: &[PlannedRun],
    at_once: usize,
    stop: watch::Receiver<bool>,
    progress: &mut ExperimentProgress,
) -> anyhow::Result<Tally> {
    let program = std::env::current_exe().context("cannot find this program")?;
    let mut tally = Tally::default();
    let mut waiting: VecDeque<&PlannedRun> = runs.iter().collect();
    let mut going = JoinSet::new();
    loop {
        while going.len() < at_once && !*stop.borrow() {
            let Some(run) = waiting.pop_front() else { break };
            if is_finished(run) {
                tally.finished += 1;
                continue;
            }
            going.spawn(finish(program.clone(), run.clone(), stop.clone()));
        }
        if going.is_empty() {
            return Ok(tally);
        }
        tokio::select! {
            Some(ended) = going.join_next() => {
                let (run, ending) = ended.context("the task of a run failed")?;
                tally.finished += usize::from(ending == Ending::Finished);
                tally.failed += usize::from(matches!(ending, Ending::Failed(_)));
                tally.misplaced += usize::from(matches!(ending, Ending::Misplaced(_)));
                progress.ended(&run, &ending);
            }
            () = tokio::time::sleep(POLL_INTERVAL) => progress.show(runs, going.len()),
        }
    }
}

/// Starts or resumes one run and waits for its end.
async fn finish(
    program: PathBuf,
    run: PlannedRun,
    mut stop: watch::Receiver<bool>,
) -> (PlannedRun, Ending) {
    let ending = train(&program, &run, &mut stop).await;
    let ending = ending.unwrap_or_else(|error| Ending::Failed(format!("{error:#}")));
    (run, ending)
}

async fn train(
    program: &Path,
    run: &PlannedRun,
    stop: &mut watch::Receiver<bool>,
) -> anyhow::Result<Ending> {
    let Some(log) = locked_log(&run.log(), stop).await? else { return Ok(Ending::Stopped) };
    if let Some(why) = mismatch(run) {
        return Ok(Ending::Misplaced(why));
    }
    if is_finished(run) {
        return Ok(Ending::Finished);
    }
    let own_log = ProcessLog::before_start(&run.log());
    let mut child = start(program, run, log)?;
    let stdin = child.stdin.take();
    let stopped = async {
        // Without its sender no stop can come.
        if stop.wait_for(|stop| *stop).await.is_err() {
            std::future::pending::<()>().await;
        }
        drop(stdin);
    };
    let status = ended(&mut child, stopped).await.context("cannot wait for a run")?;
    Ok(match (status.success(), run_state(run)) {
        (true, RunFolderState::Finished) => Ending::Finished,
        (true, _) => Ending::Stopped,
        (false, _) => {
            Ending::Failed(format!("{}; its log is {}", own_log.cause(status), run.log().display()))
        }
    })
}

/// Waits for the end of a process, before or after the stop request.
async fn ended(
    child: &mut Child,
    stopped: impl Future<Output = ()>,
) -> std::io::Result<ExitStatus> {
    tokio::select! {
        status = child.wait() => return status,
        () = stopped => {}
    }
    child.wait().await
}

/// The run's log, locked. The process that writes to it holds the lock until it ends. A run of an experiment that was
/// killed may therefore still write its last checkpoint. `None` if stopped while waiting.
async fn locked_log(path: &Path, stop: &watch::Receiver<bool>) -> anyhow::Result<Option<File>> {
    let log = plain_file::append(path);
    let log = log.with_context(|| format!("cannot write {}", path.display()))?;
    loop {
        match log.try_lock() {
            Ok(()) => return Ok(Some(log)),
            Err(TryLockError::WouldBlock) if *stop.borrow() => return Ok(None),
            Err(TryLockError::WouldBlock) => tokio::time::sleep(POLL_INTERVAL).await,
            Err(TryLockError::Error(error)) => {
                return Err(error).with_context(|| {
                    format!("cannot lock {}: its file system must support flock", path.display())
                });
            }
        }
    }
}

/// A process of its own group, so that Ctrl-C reaches it only through its standard input, which closes.
fn start(program: &Path, run: &PlannedRun, log: File) -> anyhow::Result<Child> {
    let mut command = Command::new(program);
    command.args(["train", "--stop-with-stdin", "--page", "off"]).args(&run.settings);
    match run_state(run) {
        RunFolderState::New => command.arg(format!("run.dir={}", run.folder.display())),
        // As one word, because the path may begin with `-`.
        _ => command.arg(format!("--resume={}", run.folder.display())),
    };
    let started = command
        .stdin(Stdio::piped())
        .stdout(log.try_clone().context("cannot share a log")?)
        .stderr(log)
        .process_group(0)
        .spawn();
    started.with_context(|| format!("cannot start {}", program.display()))
}
