//! Runs an experiment's trainings, several at once, each in its own process: starts new ones, resumes stopped ones, skips finished
//! ones, and shows how far all are. A run that fails does not stop the others.

use std::collections::VecDeque;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use learner::store::plain_file;
use tokio::process::{Child, Command};
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::PlannedRun;
use super::run_state::{Ending, RunFolderState, is_finished, mismatch, run_state};
use crate::config::layers::ENVIRONMENT_PREFIX;
use crate::figures::chart;
use crate::process::{self, ProcessLog, output};
use crate::progress::Screen;

/// Poll interval for the progress of runs and for a locked log.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

/// Time between two plain lines.
const LINE_PERIOD: Duration = Duration::from_secs(30);

/// Layout of the bar.
const BAR: &str = "{bar:40.cyan/black} {percent} %\n{wide_msg}";

/// Numbers of runs by how they ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    /// Finished runs, including those that were finished before.
    pub(crate) finished: usize,
    /// Failed runs.
    pub(crate) failed: usize,
    /// Runs whose folders hold runs with other settings.
    pub(crate) misplaced: usize,
    /// Runs that ended before their last iteration, with a checkpoint.
    pub(crate) stopped: usize,
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
                match &ending {
                    Ending::Finished => tally.finished += 1,
                    Ending::Failed(_) => tally.failed += 1,
                    Ending::Misplaced(_) => tally.misplaced += 1,
                    Ending::Stopped => tally.stopped += 1,
                }
                progress.ended(&run, &ending);
            }
            () = tokio::time::sleep(POLL_INTERVAL) => progress.show(runs, going.len()),
        }
    }
}

/// Shows how far an experiment is.
pub(crate) struct ExperimentProgress {
    begin: Instant,
    /// How far each run was when last looked at; a finished one needs no other look.
    known: Vec<RunFolderState>,
    /// Environment steps that were done before.
    steps_before: u64,
    screen: Screen,
}

impl ExperimentProgress {
    /// Before the first run starts.
    pub(crate) fn new(runs: &[PlannedRun]) -> Self {
        let begin = Instant::now();
        let known: Vec<RunFolderState> = runs.iter().map(run_state).collect();
        let (done, total) = steps(runs, &known);
        let mut screen = Screen::new(total, BAR, LINE_PERIOD);
        // The first plain line follows after one period.
        screen.is_due(begin);
        Self { begin, known, steps_before: done, screen }
    }

    /// Shows how far `runs` are, of which `going` are at work.
    pub(crate) fn show(&mut self, runs: &[PlannedRun], going: usize) {
        let now = Instant::now();
        if !self.screen.is_due(now) {
            return;
        }
        for (known, run) in self.known.iter_mut().zip(runs) {
            if *known != RunFolderState::Finished {
                *known = run_state(run);
            }
        }
        let (env_steps, total) = steps(runs, &self.known);
        let figures = ProgressFigures {
            finished: self.known.iter().filter(|known| **known == RunFolderState::Finished).count(),
            runs: runs.len(),
            going,
            env_steps,
            total,
            done: env_steps.saturating_sub(self.steps_before),
            secs: now.duration_since(self.begin).as_secs_f64(),
        };
        match &self.screen {
            Screen::Bar(bar) => {
                bar.set_position(env_steps);
                bar.set_message(figures.words());
            }
            Screen::Lines(..) => output::line(figures.words()),
        }
    }

    /// Prints how a run ended.
    pub(crate) fn ended(&self, run: &PlannedRun, ending: &Ending) {
        let line = match ending {
            Ending::Finished => format!("{} is finished", run.name()),
            Ending::Stopped => format!("{} stopped; it can be resumed", run.name()),
            Ending::Failed(why) => format!("{} failed: {why}", run.name()),
            Ending::Misplaced(why) => format!("{} cannot begin: {why}", run.name()),
        };
        self.screen.line(&line);
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
    let stopped = async {
        // Without its sender no stop can come.
        if stop.wait_for(|stop| *stop).await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    let status = match process::until_exit(&mut child, stopped).await {
        Some(status) => status,
        None => child.wait().await,
    };
    let status = status.context("cannot wait for a run")?;
    Ok(match (status.success(), run_state(run)) {
        (true, RunFolderState::Finished) => Ending::Finished,
        (true, _) => Ending::Stopped,
        (false, _) => {
            Ending::Failed(format!("{}; its log is {}", own_log.cause(status), run.log().display()))
        }
    })
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

/// Starts or resumes the training of a run.
fn start(program: &Path, run: &PlannedRun, log: File) -> anyhow::Result<Child> {
    let mut command = Command::new(program);
    // A resume would refuse another folder than the run's.
    let own = format!("{ENVIRONMENT_PREFIX}RUN__DIR");
    for (name, _) in std::env::vars_os() {
        if name.eq_ignore_ascii_case(&own) {
            command.env_remove(name);
        }
    }
    command.args(["train", "--stop-with-stdin", "--page", "off"]).args(&run.settings);
    match run_state(run) {
        RunFolderState::New => command.arg(format!("run.dir={}", run.folder.display())),
        // As one word, because the path may begin with `-`.
        _ => command.arg(format!("--resume={}", run.folder.display())),
    };
    command.stdout(log.try_clone().context("cannot share a log")?).stderr(log);
    process::start(&mut command)
}

/// How far an experiment is.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ProgressFigures {
    finished: usize,
    runs: usize,
    going: usize,
    env_steps: u64,
    total: u64,
    /// Environment steps done since this process began, and how long that took.
    done: u64,
    secs: f64,
}

impl ProgressFigures {
    fn words(&self) -> String {
        let speed = self.done as f64 / self.secs.max(f64::MIN_POSITIVE);
        let (env_steps, total) = (chart::thousands(self.env_steps), chart::thousands(self.total));
        let left = match self.done {
            0 => String::new(),
            _ => {
                let left = (self.total - self.env_steps) as f64 / speed;
                format!(
                    "  {} steps/s  {} left",
                    chart::thousands(speed as u64),
                    chart::duration(left)
                )
            }
        };
        let Self { finished, runs, going, .. } = self;
        format!("{finished}/{runs} runs finished, {going} at work  {env_steps}/{total} steps{left}")
    }
}

/// Environment steps that are done, and all of them.
fn steps(runs: &[PlannedRun], known: &[RunFolderState]) -> (u64, u64) {
    let total = |run: &PlannedRun| run.config.env_steps();
    let done = runs.iter().zip(known).map(|(run, known)| known.env_steps(total(run))).sum();
    (done, runs.iter().map(total).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_counts_only_what_was_done_since_the_start() {
        let figures = ProgressFigures {
            finished: 1,
            runs: 4,
            going: 2,
            env_steps: 6_000,
            total: 16_000,
            done: 2_000,
            secs: 20.0,
        };
        // 10,000 steps are left, 100 a second.
        let expected = "1/4 runs finished, 2 at work  6,000/16,000 steps  100 steps/s  1m40s left";
        assert_eq!(figures.words(), expected);
        let words = ProgressFigures { done: 0, ..figures }.words();
        assert_eq!(words, "1/4 runs finished, 2 at work  6,000/16,000 steps");
    }
}
