//! The actor processes of `s2mia train`: starts them, replaces those that fail, gives up after repeated failures, and
//! ends all with the run.

use std::ffi::OsString;
use std::fs::File;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use learner::store::plain_file;
use proto::Episodes;
use recording::trajectory_log::LogSettings;
use security::Token;
use tokio::process::{Child, Command};
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::errors::ENVIRONMENT_OUTAGE;
use crate::process::{self, ProcessLog};

/// Timeout for an actor to exit after its standard input has closed.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest time between an actor's end and that of its run: the learner waits up to 3 s for the others.
const RUN_END_TIMEOUT: Duration = Duration::from_secs(10);
/// [`EXIT_TIMEOUT`] for an actor that has to finish and check a trajectory log.
const LOG_EXIT_TIMEOUT: Duration = Duration::from_secs(60);

/// Delay before a replacement, so that a broken program does not restart continuously.
const REPLACEMENT_PAUSE: Duration = Duration::from_millis(200);

/// The actor processes of a run and their arguments.
#[derive(Clone, Debug)]
pub(crate) struct ActorProcesses {
    /// This program.
    pub(crate) program: PathBuf,
    /// URL of the learner.
    pub(crate) learner: String,
    /// Token that the learner requires.
    pub(crate) token: Token,
    /// Arguments that name an external environment, if there is one.
    pub(crate) environment: Vec<String>,
    /// Folder of `actor_<index>.log` and of trajectory logs.
    pub(crate) logs: PathBuf,
    /// Settings of trajectory logs.
    pub(crate) log: LogSettings,
    /// Number of processes.
    pub(crate) actors: usize,
}

/// Deaths of the last minute.
#[derive(Debug, Default)]
pub(crate) struct DeathCount {
    recent: Vec<Duration>,
}

impl DeathCount {
    /// Deaths within `WINDOW` after which a run gives up.
    pub(crate) const LIMIT: usize = 5;
    /// How long a death counts.
    pub(crate) const WINDOW: Duration = Duration::from_secs(60);

    /// Counts a death at `now` (since any fixed moment); true if there are now too many.
    pub(crate) fn add(&mut self, now: Duration) -> bool {
        self.recent.retain(|death| now.saturating_sub(*death) < Self::WINDOW);
        self.recent.push(now);
        self.recent.len() >= Self::LIMIT
    }
}

/// Keeps all processes running until `ended`. After too many failures, sets `stop` and returns the reason.
pub(crate) async fn supervise(
    processes: ActorProcesses,
    ended: watch::Receiver<bool>,
    stop: watch::Sender<bool>,
) -> Option<String> {
    let (deaths, failure) = (Mutex::default(), OnceLock::new());
    let supervisor =
        Arc::new(Supervisor { processes, deaths, start: Instant::now(), failure, stop });
    let mut tasks = JoinSet::new();
    for index in 0..supervisor.processes.actors {
        tasks.spawn(Arc::clone(&supervisor).keep_running(index, ended.clone()));
    }
    tasks.join_all().await;
    supervisor.failure.get().cloned()
}

/// State that the tasks of all processes share.
struct Supervisor {
    processes: ActorProcesses,
    deaths: Mutex<DeathCount>,
    start: Instant,
    /// Why the supervisor gave up, once it has.
    failure: OnceLock<String>,
    stop: watch::Sender<bool>,
}

impl Supervisor {
    /// Runs one actor after the other under one index. An actor ends with success when the run is done, or after a signal.
    async fn keep_running(self: Arc<Self>, index: usize, mut ended: watch::Receiver<bool>) {
        while !*ended.borrow() && self.failure.get().is_none() {
            let own_log = ProcessLog::before_start(&self.processes.log_path(index));
            let exit_timeout = self.processes.exit_timeout();
            let death = match self.processes.start(index) {
                Ok(child) => match until_exit(child, &mut ended, exit_timeout).await {
                    Some(status) if !status.success() => {
                        let death = self.processes.failure_message(index, &own_log.cause(status));
                        if status.code() == Some(ENVIRONMENT_OUTAGE.into()) {
                            self.give_up(death);
                            return;
                        }
                        death
                    }
                    // The learner says that the run is done shortly before it ends.
                    Some(_) if !ends_within(RUN_END_TIMEOUT, &mut ended).await => {
                        format!("actor {index} was stopped")
                    }
                    _ => return,
                },
                Err(error) => format!("actor {index} did not start: {error:#}"),
            };
            if *self.stop.borrow() || *ended.borrow() {
                return;
            }
            self.report(&death);
            tokio::time::sleep(REPLACEMENT_PAUSE).await;
        }
    }

    fn report(&self, death: &str) {
        let too_many = {
            let mut deaths = self.deaths.lock().expect("no thread panics while it holds this lock");
            deaths.add(self.start.elapsed())
        };
        if !too_many {
            tracing::warn!("{death}; starting another in its place");
            return;
        }
        self.give_up(format!("{} actor deaths within a minute; {death}", DeathCount::LIMIT));
    }

    fn give_up(&self, failure: String) {
        self.failure.get_or_init(|| failure);
        self.stop.send_replace(true);
    }
}

impl ActorProcesses {
    /// Starts a process, which Ctrl-C reaches only through its learner.
    fn start(&self, index: usize) -> anyhow::Result<Child> {
        let log = self.log_path(index);
        let log: File =
            plain_file::append(&log).with_context(|| format!("cannot write {}", log.display()))?;
        let mut command = Command::new(&self.program);
        command
            .args(["actor", "--exit-with-stdin", "--learner", &self.learner])
            .args(["--name", &format!("local-{index}")])
            .args(&self.environment)
            .args(self.log_arguments())
            // Other users can read the arguments of a process, but not its environment.
            .env(Token::VARIABLE, self.token.text())
            .stdout(Stdio::null())
            .stderr(log)
            .kill_on_drop(true);
        process::start(&mut command)
    }

    /// Arguments for trajectory logging, if it is enabled.
    fn log_arguments(&self) -> Vec<OsString> {
        let episodes = self.log.episodes;
        if episodes == Episodes::None {
            return Vec::new();
        }
        // As one word, because the path may begin with `-`.
        let mut folder = OsString::from("--log-dir=");
        folder.push(&self.logs);
        vec![folder, "--log-episodes".into(), episodes.to_string().into()]
    }

    fn exit_timeout(&self) -> Duration {
        match self.log.episodes {
            Episodes::None => EXIT_TIMEOUT,
            _ => LOG_EXIT_TIMEOUT,
        }
    }

    fn log_path(&self, index: usize) -> PathBuf {
        self.logs.join(format!("actor_{index}.log"))
    }

    fn failure_message(&self, index: usize, cause: &str) -> String {
        format!("actor {index} died ({cause}); its log is {}", self.log_path(index).display())
    }
}

/// Whether the run ends within a time.
async fn ends_within(time: Duration, ended: &mut watch::Receiver<bool>) -> bool {
    // Without its sender the run has ended.
    tokio::time::timeout(time, ended.wait_for(|over| *over)).await.is_ok()
}

/// Waits for a process. After `ended`, closes its standard input and kills it after `exit_timeout`. `None` if the run
/// ended first.
async fn until_exit(
    mut child: Child,
    ended: &mut watch::Receiver<bool>,
    exit_timeout: Duration,
) -> Option<ExitStatus> {
    // Without its sender the run has ended.
    let over = async { drop(ended.wait_for(|over| *over).await) };
    if let Some(status) = process::until_exit(&mut child, over).await {
        return status.ok();
    }
    if tokio::time::timeout(exit_timeout, child.wait()).await.is_err() {
        // The process ignores its closed input; killing it loses nothing.
        let _killed = child.kill().await;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    fn processes_of(folder: &tempfile::TempDir, script: &str) -> ActorProcesses {
        let program = folder.path().join("actor.sh");
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        ActorProcesses {
            program,
            learner: "http://127.0.0.1:1".into(),
            token: Token::random().unwrap(),
            environment: Vec::new(),
            logs: folder.path().into(),
            log: LogSettings { episodes: Episodes::None },
            actors: 2,
        }
    }

    #[test]
    fn five_deaths_within_a_minute_are_too_many_and_any_number_a_quarter_apart_is_not() {
        let mut deaths = DeathCount::default();
        let verdicts: Vec<bool> = (0..5).map(|s| deaths.add(Duration::from_secs(s * 10))).collect();
        assert_eq!(verdicts, [false, false, false, false, true]);
        let mut deaths = DeathCount::default();
        assert!(!(0..100).any(|s| deaths.add(Duration::from_secs(s * 15))));
    }

    #[tokio::test]
    async fn failing_actors_end_the_run_with_the_cause_at_once_if_it_is_their_environment() {
        for (script, words) in [
            ("echo no rapier today >&2; exit 3", &["5 actor deaths", "no rapier today"][..]),
            (
                "echo no environment today >&2; exit 4",
                &["died (exit status: 4: no environment today)"],
            ),
            // The cause of a killed actor is no line of its log.
            ("echo all is well >&2; kill -9 $$", &["died (signal: 9 (SIGKILL)); its log is"]),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let (stop, stopped) = watch::channel(false);
            let (_end, ended) = watch::channel(false);
            let reason = supervise(processes_of(&folder, script), ended, stop).await.unwrap();
            assert!(words.iter().all(|words| reason.contains(words)), "{reason}");
            assert!(*stopped.borrow());
        }
    }

    #[tokio::test]
    async fn an_actor_that_stops_before_the_run_ends_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let mut processes = processes_of(&folder, "echo started >> \"$0.starts\"");
        processes.actors = 1;
        let starts = folder.path().join("actor.sh.starts");
        let (stop, _stopped) = watch::channel(false);
        let (end, ended) = watch::channel(false);
        let supervised = tokio::spawn(supervise(processes, ended, stop));
        let count = || std::fs::read_to_string(&starts).map_or(0, |text| text.lines().count());
        let replaced = async {
            while count() < 2 {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        };
        tokio::time::timeout(3 * RUN_END_TIMEOUT, replaced).await.unwrap();
        end.send_replace(true);
        assert_eq!(supervised.await.unwrap(), None);
    }

    #[tokio::test]
    async fn actors_leave_when_the_run_ends() {
        let folder = tempfile::tempdir().unwrap();
        let processes = processes_of(&folder, "cat > /dev/null");
        let (stop, _stopped) = watch::channel(false);
        let (end, ended) = watch::channel(false);
        let supervised = tokio::spawn(supervise(processes, ended, stop));
        tokio::time::sleep(Duration::from_millis(100)).await;
        assert!(!supervised.is_finished());
        end.send_replace(true);
        let reason = tokio::time::timeout(Duration::from_secs(5), supervised).await.unwrap();
        assert_eq!(reason.unwrap(), None);
    }
}
