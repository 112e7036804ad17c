//! The thread that writes a log, and the desk at which the stepping thread hands in what belongs into it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use proto::{Episodes, EvaluationWork, Lease, RolloutWork, RunDescription};
use sim::{EnvironmentBatch, TaskConfig};

use super::config::LogConfig;
use super::file::{LogFile, Origin};
use super::shares::LoggedShare;
use super::witness::{EvaluationWitness, Rollout, RolloutWitness};
use super::{cut, source};
use crate::error::ActorError;
use crate::recording::RecordError;

/// Leases that may wait to be written. When the queue is full, what is handed in is lost and counted: a slow disk
/// costs part of the log and never a step of the roll-out.
const QUEUE: usize = 32;

/// An actor's log, from its start to its end.
pub(crate) struct Log {
    orders: SyncSender<Order>,
    lost: Arc<Lost>,
    episodes: Episodes,
    actor: String,
    thread: JoinHandle<()>,
}

/// Where the stepping thread of one session hands in.
pub(crate) struct Desk {
    orders: SyncSender<Order>,
    lost: Arc<Lost>,
    episodes: Episodes,
    run: Arc<RunDescription>,
    origin: Arc<Origin>,
}

enum Order {
    Rollout(Arc<Origin>, Box<Rollout>),
    Evaluation(Arc<Origin>, Box<LoggedShare>),
    /// Finish the last file; what is still on its way is lost.
    Close,
}

/// What was logged and not written.
#[derive(Debug, Default)]
struct Lost {
    /// Since it was last asked for.
    shares: AtomicU64,
    /// Since it was last asked for.
    steps: AtomicU64,
    /// Steps that the learner has not been told of.
    untold: AtomicU64,
}

impl Lost {
    fn add(&self, shares: usize, steps: usize) {
        self.shares.fetch_add(shares as u64, Ordering::Relaxed);
        self.steps.fetch_add(steps as u64, Ordering::Relaxed);
        self.untold.fetch_add(steps as u64, Ordering::Relaxed);
    }

    /// Shares and steps; counting begins again.
    fn take(&self) -> (u64, u64) {
        (self.shares.swap(0, Ordering::Relaxed), self.steps.swap(0, Ordering::Relaxed))
    }
}

impl Log {
    /// Makes the folder and starts the thread. `actor` stands in the files' names.
    pub(crate) fn start(config: &LogConfig, actor: &str) -> Result<Self, ActorError> {
        source::make_folder(&config.folder)?;
        let lost = Arc::new(Lost::default());
        let clerk = Clerk {
            config: config.clone(),
            actor: actor.to_owned(),
            lost: Arc::clone(&lost),
            file: None,
            broken: false,
            written: (0, 0),
            gone: (0, 0),
        };
        let (orders, queue) = sync_channel(QUEUE);
        let thread = std::thread::Builder::new().name("log".to_owned());
        let thread = thread
            .spawn(move || clerk.work(&queue))
            .expect("a process can start its one log thread");
        let (episodes, actor) = (config.settings.episodes, actor.to_owned());
        Ok(Self { orders, lost, episodes, actor, thread })
    }

    /// The desk for one session.
    pub(crate) fn desk(&self, run: &Arc<RunDescription>, task: &TaskConfig) -> Desk {
        let origin = Origin::of_run(run, task, &self.actor, self.episodes);
        Desk {
            run: Arc::clone(run),
            orders: self.orders.clone(),
            lost: Arc::clone(&self.lost),
            episodes: self.episodes,
            origin: Arc::new(origin),
        }
    }

    /// Lost steps that the learner has not been told of.
    pub(crate) fn untold(&self) -> u64 {
        self.lost.untold.load(Ordering::Relaxed)
    }

    /// The learner has been told of `steps` of them.
    pub(crate) fn tell(&self, steps: u64) {
        self.lost.untold.fetch_sub(steps, Ordering::Relaxed);
    }

    /// Waits until everything is on the disk.
    pub(crate) fn close(self) {
        // Both fail only if the thread is gone; it has then said why.
        let _asked = self.orders.send(Order::Close);
        let _ended = self.thread.join();
    }
}

impl Desk {
    /// Who watches a slot.
    pub(crate) fn rollout<'a>(&self, lease: &Lease, work: &'a RolloutWork) -> RolloutWitness<'a> {
        RolloutWitness::new(self.episodes, &self.run, lease, work)
    }

    /// Who watches an evaluation's episode, which stands at its start, if it is logged.
    pub(crate) fn evaluation(
        &self,
        lease: &Lease,
        work: EvaluationWork,
        world: &dyn EnvironmentBatch,
    ) -> Option<EvaluationWitness> {
        let held = self.episodes.include_evaluation(work.episode);
        held.then(|| EvaluationWitness::new(&self.run, lease, work, world)).flatten()
    }

    /// Hands in what was seen of a slot.
    pub(crate) fn take_rollout(&self, witness: RolloutWitness<'_>) {
        let Some(rollout) = witness.finish() else { return };
        let steps = rollout.begun.iter().map(|share| share.poses.len()).sum();
        let shares = rollout.begun.len();
        self.hand_in(Order::Rollout(Arc::clone(&self.origin), Box::new(rollout)), shares, steps);
    }

    /// Hands in an evaluation's episode.
    pub(crate) fn take_evaluation(&self, witness: EvaluationWitness) {
        let share = witness.finish();
        let steps = share.steps.len();
        self.hand_in(Order::Evaluation(Arc::clone(&self.origin), Box::new(share)), 1, steps);
    }

    fn hand_in(&self, order: Order, shares: usize, steps: usize) {
        if self.orders.try_send(order).is_err() {
            self.lost.add(shares, steps);
        }
    }
}

/// The thread's side.
struct Clerk {
    config: LogConfig,
    actor: String,
    lost: Arc<Lost>,
    /// The open file, and what session it is of.
    file: Option<(Arc<Origin>, LogFile)>,
    /// Nothing is written any more.
    broken: bool,
    /// Shares and steps so far.
    written: (u64, u64),
    /// Shares and steps that earlier files tell as lost.
    gone: (u64, u64),
}

impl Clerk {
    fn work(mut self, orders: &Receiver<Order>) {
        while let Ok(order) = orders.recv() {
            match order {
                Order::Rollout(origin, rollout) => {
                    cut::shares(*rollout).iter().for_each(|share| self.write(&origin, share));
                }
                Order::Evaluation(origin, share) => self.write(&origin, &share),
                Order::Close => break,
            }
        }
        let finished = self.finish();
        self.survive(finished);
        self.report();
    }

    /// Writes a share, or counts it as lost.
    fn write(&mut self, origin: &Arc<Origin>, share: &LoggedShare) {
        let written = match self.broken {
            true => false,
            false => {
                let attempt = self.attempt(origin, share);
                self.survive(attempt)
            }
        };
        match written {
            true => {
                self.written.0 += 1;
                self.written.1 += share.steps.len() as u64;
            }
            false => self.lost.add(1, share.steps.len()),
        }
    }

    /// The first failure ends the log, not the actor.
    fn survive(&mut self, attempt: Result<(), RecordError>) -> bool {
        let Err(error) = attempt else { return true };
        let folder = self.config.folder.display();
        tracing::warn!("the log in {folder} ends here, the roll-out goes on: {error}");
        (self.broken, self.file) = (true, None);
        false
    }

    fn attempt(&mut self, origin: &Arc<Origin>, share: &LoggedShare) -> Result<(), RecordError> {
        if self.file.as_ref().is_some_and(|(of, _)| !Arc::ptr_eq(of, origin)) {
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
        if file.bytes()? >= self.config.settings.max_file_mib << 20 {
            self.finish()?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), RecordError> {
        let Some((_, file)) = self.file.take() else { return Ok(()) };
        let lost = self.lost.take();
        self.gone = (self.gone.0 + lost.0, self.gone.1 + lost.1);
        file.finish(lost)
    }

    /// The last words, in the actor's own log.
    fn report(&self) {
        let (folder, (shares, steps)) = (self.config.folder.display(), self.written);
        tracing::info!("logged {steps} steps in {shares} shares of episodes to {folder}");
        let late = self.lost.take();
        let (shares, steps) = (self.gone.0 + late.0, self.gone.1 + late.1);
        if shares > 0 {
            tracing::warn!("{steps} steps in {shares} shares of episodes are missing from the log");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory_log::tests::{evaluate, start};

    #[test]
    fn what_is_lost_is_told_once() {
        let lost = Lost::default();
        lost.add(2, 30);
        lost.add(1, 5);
        assert_eq!((lost.take(), lost.take()), ((3, 35), (0, 0)));
        assert_eq!(lost.untold.load(Ordering::Relaxed), 35, "the learner has not heard of them");
    }

    #[test]
    fn a_full_queue_loses_what_comes_and_holds_nobody_up() {
        let folder = tempfile::tempdir().unwrap();
        let (log, desk) = start(folder.path(), "a", Episodes::All, 1);
        log.close();
        let ((orders, waiting), lost) = (sync_channel(1), Arc::new(Lost::default()));
        let desk = Desk { orders, lost: Arc::clone(&lost), ..desk };
        for _ in 0..3 {
            evaluate(&desk, EvaluationWork { iteration: 0, episode: 0 });
        }
        assert_eq!(lost.take(), (2, 50), "one waits, two episodes of 25 steps are lost");
        assert_eq!(waiting.try_iter().count(), 1);
    }

    #[test]
    fn a_folder_that_cannot_be_is_refused_in_one_line() {
        let settings = crate::LogSettings { episodes: Episodes::All, max_file_mib: 1 };
        let folder = "/dev/null/logs".into();
        let refusal = Log::start(&LogConfig { folder, settings }, "a").err().map(|e| e.to_string());
        let line = refusal.unwrap_or_default();
        assert!(line.contains("cannot make /dev/null/logs") && !line.contains('\n'), "{line}");
    }
}
