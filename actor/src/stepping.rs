//! The thread that steps worlds: takes one job at a time, streams its results back.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use policy::{Key, PolicySnapshot, RunSeed};
use proto::wire::push_trajectory_request::Content;
use proto::{
    ActionChoice, EvaluationResult, EvaluationWork, Film, Lease, PushHeader, RolloutWork,
    RunDescription, Work, wire,
};
use sim::{EnvironmentBatch, SimError};
use tokio::sync::mpsc;

use crate::error::ActorError;
use crate::evaluation::play_on;
use crate::film::{Camera, FILMED};
use crate::rollout::roll_out;
use crate::source::Source;
use crate::trajectory_log::Desk;

/// Results that may wait for the network. When the queue is full the stepping thread waits: a slow
/// network slows the roll-out and loses nothing.
const QUEUE: usize = 4;

/// One lease to work off, and how its progress is watched and broken off.
pub(crate) struct Job {
    pub(crate) lease: Lease,
    pub(crate) policy: Arc<PolicySnapshot>,
    pub(crate) watch: Arc<Watch>,
}

/// What the two sides of a job share while it runs.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    /// Steps done.
    pub(crate) step: AtomicU32,
    /// Set when nobody wants the result any more.
    pub(crate) cancelled: AtomicBool,
}

/// What comes back.
pub(crate) enum Produced {
    /// A message for the learner.
    Message(Box<wire::PushTrajectoryRequest>),
    /// The job has ended, whole or broken off.
    End,
    /// The lease's environment states are none of this task's, or whoever steps the environments failed.
    Failed(SimError),
}

/// The two ends of the stepping thread.
pub(crate) struct Stepper {
    pub(crate) jobs: mpsc::Sender<Job>,
    pub(crate) produced: mpsc::Receiver<Produced>,
}

struct Worlds {
    run: Arc<RunDescription>,
    slot: Box<dyn EnvironmentBatch>,
    /// One environment of its own, so that evaluation touches no slot's.
    evaluation: Box<dyn EnvironmentBatch>,
    /// Where what is logged is handed in; `None` for external environments.
    desk: Option<Desk>,
}

impl Stepper {
    /// Opens the run's environments and starts the thread; it ends when the stepper is dropped.
    pub(crate) fn start(
        run: Arc<RunDescription>,
        source: &Source,
        desk: Option<Desk>,
    ) -> Result<Self, ActorError> {
        let slot = source.open(run.environments_per_slot as usize)?;
        let worlds = Worlds { run, slot, evaluation: source.open(1)?, desk };
        let (jobs, queue) = mpsc::channel(1);
        let (results, produced) = mpsc::channel(QUEUE);
        let thread = std::thread::Builder::new().name("stepping".to_owned());
        thread
            .spawn(move || step_until_dropped(worlds, queue, &results))
            .expect("a process can start its one stepping thread");
        Ok(Self { jobs, produced })
    }
}

fn step_until_dropped(
    mut worlds: Worlds,
    mut jobs: mpsc::Receiver<Job>,
    results: &mpsc::Sender<Produced>,
) {
    while let Some(job) = jobs.blocking_recv() {
        let end = match worlds.work_off(&job, results) {
            Ok(()) => Produced::End,
            Err(error) => Produced::Failed(error),
        };
        if results.blocking_send(end).is_err() {
            return;
        }
    }
}

impl Worlds {
    fn work_off(&mut self, job: &Job, results: &mpsc::Sender<Produced>) -> Result<(), SimError> {
        match &job.lease.work {
            Work::Rollout(work) => self.roll_out(job, work, results),
            Work::Evaluation(work) => {
                let (result, film) = self.evaluate(job, *work)?;
                let content = Content::Evaluation(result.to_wire());
                let header = PushHeader::of(&job.lease, result.digest(work.iteration));
                let mut message = header.to_wire(content);
                message.film = film.as_ref().map(Film::to_wire);
                // Nobody waits behind an evaluation's only message.
                let _ = send(job, message, results);
                Ok(())
            }
        }
    }

    fn roll_out(
        &mut self,
        job: &Job,
        work: &RolloutWork,
        results: &mpsc::Sender<Produced>,
    ) -> Result<(), SimError> {
        let Self { run, slot, desk, .. } = self;
        let witness = desk.as_ref().map(|desk| RefCell::new(desk.rollout(&job.lease, work)));
        let see = |step, world: &dyn EnvironmentBatch| {
            job.watch.step.store(step, Ordering::Relaxed);
            if let Some(witness) = &witness {
                witness.borrow_mut().see(step, world);
            }
        };
        let origin = work.origin();
        roll_out(run, work, &job.policy, slot.as_mut(), see, |chunk| {
            let (message, digest) = chunk.to_wire(run, &origin);
            if let Some(witness) = &witness {
                witness.borrow_mut().keep(chunk);
            }
            let content = Content::Chunk(message);
            send(job, PushHeader::of(&job.lease, digest).to_wire(content), results)
        })?;
        if let (Some(desk), Some(witness)) = (desk, witness) {
            desk.take_rollout(witness.into_inner());
        }
        Ok(())
    }

    fn evaluate(
        &mut self,
        job: &Job,
        work: EvaluationWork,
    ) -> Result<(EvaluationResult, Option<Film>), SimError> {
        let key = Key::of_evaluation(RunSeed(self.run.seed), work.iteration, work.episode);
        let world = self.evaluation.as_mut();
        world.reset(0, 0, world.description().episode_steps, key.0)?;
        let desk = self.desk.as_ref();
        let mut witness = desk.and_then(|desk| desk.evaluation(&job.lease, work, world));
        let mut camera = match work.episode {
            FILMED => Camera::before(world)?,
            _ => None,
        };
        let mut steps = 0;
        let episode = play_on(world, (&job.policy, ActionChoice::Mean), &mut |step| {
            steps += 1;
            job.watch.step.store(steps, Ordering::Relaxed);
            if let Some(camera) = &mut camera {
                camera.see(step.world);
            }
            if let Some(witness) = &mut witness {
                witness.see(step);
            }
        })?;
        if let (Some(desk), Some(witness)) = (desk, witness) {
            desk.take_evaluation(witness);
        }
        let result = EvaluationResult {
            episode: work.episode,
            extrinsic_return: episode.extrinsic_return,
            steps: episode.steps,
        };
        Ok((result, camera.map(Camera::film)))
    }
}

fn send(
    job: &Job,
    message: wire::PushTrajectoryRequest,
    results: &mpsc::Sender<Produced>,
) -> ControlFlow<()> {
    if job.watch.cancelled.load(Ordering::Relaxed) {
        return ControlFlow::Break(());
    }
    match results.blocking_send(Produced::Message(Box::new(message))) {
        Ok(()) => ControlFlow::Continue(()),
        Err(_) => ControlFlow::Break(()),
    }
}
