//! The stepping thread, which processes one job at a time and returns its results through a queue.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use policy::{PolicySnapshot, RunSeed};
use proto::wire::push_trajectory_request::Content;
use proto::{
    ActionChoice, EvaluationResult, EvaluationWork, Film, Lease, PushHeader, RolloutWork,
    RunDescription, Work, wire,
};
use recording::trajectory_log::LogHandle;
use rollout::{EvaluationEpisode, FILMED, FilmRecorder, StepEvent, play_episode, roll_out};
use sim::{Disturbances, EnvironmentBatch, SimError};
use tokio::sync::{Notify, mpsc};

use crate::error::ActorError;
use crate::source::EnvironmentSource;

/// Capacity of the queue of results. When it is full, the stepping thread waits: a slow network delays the rollout and
/// loses nothing.
const QUEUE: usize = 4;

/// Share of a slot's steps after which the next lease is requested. Later, a round trip to the learner would be lost; earlier, a
/// slow machine would take slots that others finish first.
const NEARLY: f64 = 0.75;

/// A lease to process, with its shared progress.
pub(crate) struct Job {
    pub(crate) lease: Lease,
    pub(crate) policy: Arc<PolicySnapshot>,
    pub(crate) progress: Arc<JobProgress>,
}

/// Progress of a running job, shared with the network side.
#[derive(Debug, Default)]
pub(crate) struct JobProgress {
    /// Number of steps done.
    pub(crate) step: AtomicU32,
    /// Notified when [`NEARLY`] of a slot's steps are done.
    pub(crate) nearly_done: Notify,
    /// Whether the job is cancelled.
    pub(crate) cancelled: AtomicBool,
}

/// Output of the stepping thread.
pub(crate) enum JobOutput {
    /// A message for the learner.
    Message(Box<wire::PushTrajectoryRequest>),
    /// The job is finished or was cancelled.
    End,
    /// An environment state of the lease is invalid, or an external environment failed.
    Failed(SimError),
}

/// Queues to and from the stepping thread.
pub(crate) struct Stepper {
    pub(crate) jobs: mpsc::Sender<Job>,
    pub(crate) outputs: mpsc::Receiver<JobOutput>,
}

struct Worlds {
    run: Arc<RunDescription>,
    source: EnvironmentSource,
    /// As many environments as the last slot had.
    slot: Box<dyn EnvironmentBatch>,
    /// Environment for evaluations, separate from those of slots.
    evaluation: Box<dyn EnvironmentBatch>,
    /// Handle of the log; `None` without a log and for external environments.
    handle: Option<LogHandle>,
}

impl Stepper {
    /// Opens the run's environments and starts the thread; it ends when the stepper is dropped.
    pub(crate) fn start(
        run: Arc<RunDescription>,
        source: &EnvironmentSource,
        handle: Option<LogHandle>,
    ) -> Result<Self, ActorError> {
        let open = |count| source.open(count).map_err(ActorError::of_task);
        let slot = open(run.environments_per_slot as usize)?;
        let mut evaluation = open(1)?;
        evaluation.set_disturbances(Disturbances::AsInEvaluations);
        let source = source.clone();
        let worlds = Worlds { run, source, slot, evaluation, handle };
        // Environments of another program open their streams in the runtime.
        let runtime = tokio::runtime::Handle::current();
        let (jobs, queue) = mpsc::channel(1);
        let (results, outputs) = mpsc::channel(QUEUE);
        let thread = std::thread::Builder::new().name("stepping".to_owned());
        let started = thread.spawn(move || {
            let _entered = runtime.enter();
            step_until_dropped(worlds, queue, &results);
        });
        started.map_err(|error| {
            ActorError::Other(format!("cannot start a stepping thread: {error}"))
        })?;
        Ok(Self { jobs, outputs })
    }
}

fn step_until_dropped(
    mut worlds: Worlds,
    mut jobs: mpsc::Receiver<Job>,
    results: &mpsc::Sender<JobOutput>,
) {
    while let Some(job) = jobs.blocking_recv() {
        let end = match worlds.process_lease(&job, results) {
            Ok(()) => JobOutput::End,
            Err(error) => JobOutput::Failed(error),
        };
        if results.blocking_send(end).is_err() {
            return;
        }
    }
}

impl Worlds {
    fn process_lease(
        &mut self,
        job: &Job,
        results: &mpsc::Sender<JobOutput>,
    ) -> Result<(), SimError> {
        match &job.lease.work {
            Work::Rollout(work) => self.roll_out(job, work, results),
            Work::Evaluation(work) => {
                let (result, film) = self.evaluate(job, *work)?;
                let content = Content::Evaluation(result.to_wire());
                let header = PushHeader::of(&job.lease, result.digest(work.iteration));
                let mut message = header.to_wire(content);
                message.film = film.as_ref().map(Film::to_wire);
                // The result of an evaluation is a single message; nothing is left to stop.
                let _ = send(job, message, results);
                Ok(())
            }
        }
    }

    fn roll_out(
        &mut self,
        job: &Job,
        work: &RolloutWork,
        results: &mpsc::Sender<JobOutput>,
    ) -> Result<(), SimError> {
        if self.slot.count() != work.environments.len() {
            self.slot = self.source.open(work.environments.len())?;
        }
        let Self { run, slot, handle, .. } = self;
        let nearly = (f64::from(run.slot_steps) * NEARLY) as u32;
        let mut collector = handle.as_ref().map(|handle| handle.rollout(&job.lease, work));
        let observe = |event: StepEvent<'_>| {
            if let StepEvent::Before(step, _) = event {
                job.progress.step.store(step, Ordering::Relaxed);
                if step == nearly {
                    job.progress.nearly_done.notify_one();
                }
            }
            if let Some(collector) = &mut collector {
                collector.observe(&event);
            }
        };
        let origin = work.origin();
        roll_out(run, work, &job.policy, slot.as_mut(), observe, |chunk| {
            let (message, digest) = chunk.to_wire(run, &origin);
            let content = Content::Chunk(message);
            send(job, PushHeader::of(&job.lease, digest).to_wire(content), results)
        })?;
        if let (Some(handle), Some(collector)) = (handle, collector) {
            handle.send(collector);
        }
        Ok(())
    }

    fn evaluate(
        &mut self,
        job: &Job,
        work: EvaluationWork,
    ) -> Result<(EvaluationResult, Option<Film>), SimError> {
        let (seed, EvaluationWork { iteration, episode: index }) = (RunSeed(self.run.seed), work);
        let evaluated = EvaluationEpisode { seed, iteration, index };
        let handle = self.handle.as_ref();
        let mut collector = handle.and_then(|handle| handle.evaluation(&job.lease, evaluated));
        let mut recorder = None;
        let start = (evaluated.key(), choice(&self.run, index));
        let episode = play_episode(self.evaluation.as_mut(), &job.policy, start, |event| {
            if let StepEvent::After(played) = &event {
                job.progress.step.store(played.step, Ordering::Relaxed);
            }
            if index == FILMED {
                FilmRecorder::follow(&mut recorder, &event);
            }
            if let Some(collector) = &mut collector {
                collector.observe(&event);
            }
        })?;
        if let (Some(handle), Some(collector)) = (handle, collector) {
            handle.send(collector);
        }
        let result = EvaluationResult {
            episode: work.episode,
            extrinsic_return: episode.extrinsic_return,
            steps: episode.steps,
            reward_terms: episode.reward_terms,
        };
        Ok((result, recorder.map(FilmRecorder::film)))
    }
}

/// How the actions of evaluation episode `index` are chosen. Sampled ones are those of `s2mia eval --sampled` with the
/// run's seed.
fn choice(run: &RunDescription, index: u32) -> ActionChoice {
    if run.sampled_evaluations {
        ActionChoice::Sampled { seed: run.seed.wrapping_add(index.into()) }
    } else {
        ActionChoice::Mean
    }
}

fn send(
    job: &Job,
    message: wire::PushTrajectoryRequest,
    results: &mpsc::Sender<JobOutput>,
) -> ControlFlow<()> {
    if job.progress.cancelled.load(Ordering::Relaxed) {
        return ControlFlow::Break(());
    }
    match results.blocking_send(JobOutput::Message(Box::new(message))) {
        Ok(()) => ControlFlow::Continue(()),
        Err(_) => ControlFlow::Break(()),
    }
}
