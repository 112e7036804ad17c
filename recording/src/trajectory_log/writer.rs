//! The log-writer thread and the handle with which the stepping thread sends data to it.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use proto::{Episodes, Lease, RolloutWork, RunDescription};
use rollout::EvaluationEpisode;
use sim::TaskConfig;

use super::collector::ShareCollector;
use super::config::LogConfig;
use super::file::{LogFile, Origin};
use super::source;
use crate::error::RecordError;
use crate::share::LoggedShare;

/// Capacity of the queue, leases of each stepping thread. When it is full, new leases are dropped and counted: a slow
/// disk loses a part of the log but never delays the rollout.
const QUEUE: usize = 32;

/// The log of an actor.
pub struct Log {
    commands: SyncSender<Command>,
    lost: Arc<Lost>,
    episodes: Episodes,
    actor: String,
    thread: JoinHandle<()>,
}

/// Sends the log data of a session to the log-writer thread.
#[derive(Clone)]
pub struct LogHandle {
    commands: SyncSender<Command>,
    lost: Arc<Lost>,
    episodes: Episodes,
    run: Arc<RunDescription>,
    origin: Arc<Origin>,
}

enum Command {
    Write(Arc<Origin>, Vec<LoggedShare>),
    /// Finishes the last file; later commands are ignored.
    Close,
}

/// Counts of logged but unwritten shares and steps.
#[derive(Debug, Default)]
struct Lost {
    /// Shares since the last [`Self::take`].
    shares: AtomicU64,
    /// Steps since the last [`Self::take`].
    steps: AtomicU64,
    /// Steps not yet reported to the learner.
    unreported: AtomicU64,
}

impl Lost {
    fn add(&self, shares: usize, steps: usize) {
        self.shares.fetch_add(shares as u64, Ordering::Relaxed);
        self.steps.fetch_add(steps as u64, Ordering::Relaxed);
        self.unreported.fetch_add(steps as u64, Ordering::Relaxed);
    }

    /// Returns shares and steps and resets them.
    fn take(&self) -> (u64, u64) {
        (self.shares.swap(0, Ordering::Relaxed), self.steps.swap(0, Ordering::Relaxed))
    }
}

impl Log {
    /// Creates the folder and starts the log-writer thread for an actor with this number of stepping threads. `actor`
    /// is part of the file names.
    ///
    /// # Errors
    /// If the folder cannot be created or the thread cannot be started.
    pub fn start(config: &LogConfig, actor: &str, threads: usize) -> io::Result<Self> {
        let wrong = |what: String| {
            move |error: io::Error| io::Error::other(format!("cannot {what}: {error}"))
        };
        source::make_folder(&config.folder)
            .map_err(wrong(format!("create {}", config.folder.display())))?;
        let lost = Arc::new(Lost::default());
        let writer = LogWriter {
            config: config.clone(),
            actor: actor.to_owned(),
            lost: Arc::clone(&lost),
            file: None,
            broken: false,
            written: (0, 0),
            lost_before: (0, 0),
        };
        let (commands, queue) = sync_channel(QUEUE * threads);
        let thread = std::thread::Builder::new().name("log".to_owned());
        let thread = thread
            .spawn(move || writer.work(&queue))
            .map_err(wrong("start the log thread".to_owned()))?;
        let episodes = config.episodes;
        let actor = actor.to_owned();
        Ok(Self { commands, lost, episodes, actor, thread })
    }

    /// Creates the handle of a session.
    pub fn handle(&self, run: &Arc<RunDescription>, task: &TaskConfig) -> LogHandle {
        let origin = Origin::of_run(run, task, &self.actor, self.episodes);
        LogHandle {
            run: Arc::clone(run),
            commands: self.commands.clone(),
            lost: Arc::clone(&self.lost),
            episodes: self.episodes,
            origin: Arc::new(origin),
        }
    }

    /// Number of lost steps not yet reported to the learner.
    pub fn unreported(&self) -> u64 {
        self.lost.unreported.load(Ordering::Relaxed)
    }

    /// Marks `steps` lost steps as reported to the learner.
    pub fn mark_reported(&self, steps: u64) {
        self.lost.unreported.fetch_sub(steps, Ordering::Relaxed);
    }

    /// Closes the log and waits until all data is on disk.
    pub fn close(self) {
        // Both fail only if the thread has ended, which it has then logged.
        let _asked = self.commands.send(Command::Close);
        let _ended = self.thread.join();
    }
}

impl LogHandle {
    /// Creates the collector of a slot.
    pub fn rollout<'a>(&self, lease: &Lease, work: &'a RolloutWork) -> ShareCollector<'a> {
        ShareCollector::rollout(self.episodes, &self.run, lease, work)
    }

    /// Creates the collector of an evaluation episode; `None` if it is not logged.
    pub fn evaluation(
        &self,
        lease: &Lease,
        episode: EvaluationEpisode,
    ) -> Option<ShareCollector<'static>> {
        let collector = || ShareCollector::evaluation(episode, (lease.weights, lease.attempt));
        self.episodes.include_evaluation(episode.index).then(collector)
    }

    /// Sends the shares of a lease, if it is finished. If one of its states cannot be encoded, they are lost.
    pub fn send(&self, collector: ShareCollector<'_>) {
        let (count, steps) = collector.count();
        let is_sent = match collector.finish() {
            Ok(shares) if shares.is_empty() => return,
            Ok(shares) => {
                self.commands.try_send(Command::Write(Arc::clone(&self.origin), shares)).is_ok()
            }
            Err(_) => false,
        };
        if !is_sent {
            self.lost.add(count, steps);
        }
    }
}

/// State of the log-writer thread.
struct LogWriter {
    config: LogConfig,
    actor: String,
    lost: Arc<Lost>,
    /// The open file and its origin.
    file: Option<(Arc<Origin>, LogFile)>,
    /// Whether writing has failed; nothing is written any more.
    broken: bool,
    /// Written shares and steps.
    written: (u64, u64),
    /// Lost shares and steps that are recorded in finished files.
    lost_before: (u64, u64),
}

impl LogWriter {
    fn work(mut self, commands: &Receiver<Command>) {
        while let Ok(command) = commands.recv() {
            match command {
                Command::Write(origin, shares) => {
                    shares.iter().for_each(|share| self.write(&origin, share));
                }
                Command::Close => break,
            }
        }
        let finished = self.finish();
        self.end_on_error(finished);
        self.report();
    }

    /// Writes a share or counts it as lost.
    fn write(&mut self, origin: &Arc<Origin>, share: &LoggedShare) {
        let attempt = if self.broken { None } else { Some(self.attempt(origin, share)) };
        if attempt.is_some_and(|attempt| self.end_on_error(attempt)) {
            self.written.0 += 1;
            self.written.1 += share.steps.len() as u64;
        } else {
            self.lost.add(1, share.steps.len());
        }
    }

    /// Ends the log after an error, but not the actor. Returns whether there was none.
    fn end_on_error(&mut self, attempt: Result<(), RecordError>) -> bool {
        let Err(error) = attempt else { return true };
        let folder = self.config.folder.display();
        tracing::warn!(
            "cannot write the log in {folder}; logging stops, the rollout continues: {error}"
        );
        (self.broken, self.file) = (true, None);
        false
    }

    fn attempt(&mut self, origin: &Arc<Origin>, share: &LoggedShare) -> Result<(), RecordError> {
        if self.file.as_ref().is_some_and(|(of, _)| of != origin) {
            self.finish()?;
        }
        let (_, file) = match &mut self.file {
            Some(open) => open,
            none => {
                let target = source::new_log(&self.config.folder, &self.actor)?;
                none.insert((Arc::clone(origin), LogFile::begin(target, origin)?))
            }
        };
        file.write(share)?;
        if file.bytes()? >= self.config.file_bytes {
            self.finish()?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), RecordError> {
        let Some((_, file)) = self.file.take() else { return Ok(()) };
        let lost = self.lost.take();
        self.lost_before = (self.lost_before.0 + lost.0, self.lost_before.1 + lost.1);
        file.finish(lost).map(drop)
    }

    /// Reports written and lost steps in the process log.
    fn report(&self) {
        let (folder, (shares, steps)) = (self.config.folder.display(), self.written);
        tracing::info!("logged {steps} steps in {shares} shares of episodes to {folder}");
        let late = self.lost.take();
        let (shares, steps) = (self.lost_before.0 + late.0, self.lost_before.1 + late.1);
        if shares > 0 {
            tracing::warn!("{steps} steps in {shares} shares of episodes are missing from the log");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::EvaluationWork;

    use crate::trajectory_log::tests::{evaluate, start};

    #[test]
    fn lost_steps_are_counted_once() {
        let lost = Lost::default();
        lost.add(2, 30);
        lost.add(1, 5);
        assert_eq!((lost.take(), lost.take()), ((3, 35), (0, 0)));
        assert_eq!(
            lost.unreported.load(Ordering::Relaxed),
            35,
            "they are not reported to the learner yet"
        );
    }

    #[test]
    fn a_full_queue_drops_new_data_without_blocking() {
        let folder = tempfile::tempdir().unwrap();
        let (log, handle) = start(folder.path(), "a", Episodes::All, 1);
        log.close();
        let ((commands, waiting), lost) = (sync_channel(1), Arc::new(Lost::default()));
        let handle = LogHandle { commands, lost: Arc::clone(&lost), ..handle };
        for _ in 0..3 {
            evaluate(&handle, EvaluationWork { iteration: 0, episode: 0 });
        }
        assert_eq!(lost.take(), (2, 2000), "one is queued, two episodes of 1,000 steps are lost");
        assert_eq!(waiting.try_iter().count(), 1);
    }

    #[test]
    fn a_folder_that_cannot_be_created_is_an_error_in_one_line() {
        let (folder, episodes) = ("/dev/null/logs".into(), Episodes::All);
        let config = LogConfig { folder, episodes, file_bytes: 1 };
        let refusal = Log::start(&config, "a", 1).err().map(|e| e.to_string());
        let line = refusal.unwrap_or_default();
        assert!(line.contains("cannot create /dev/null/logs") && !line.contains('\n'), "{line}");
    }
}
