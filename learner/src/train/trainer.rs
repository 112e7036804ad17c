//! The training loop, which shows the data flow of the whole system. It runs on a separate thread. Time is
//! measured here and affects only reports.

mod begin_again;
mod collect;
mod divergence;
mod idle;
mod save;

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use marl::{Algorithm, Batch, MarlError, ObservationMoments, Report, StoredState as _, Surprise};
use policy::PolicySnapshot;
use policy::arrays::NamedArrays;
use proto::{PolicyVersion, WeightsName};
use rayon::ThreadPool;

use crate::error::LearnerError;
use crate::launch::Launch;
use crate::lease::exchange::Exchange;
use crate::lease::slots::SlotRollout;
use crate::observe::event::{Event, IterationReport, Stage, Summary};
use crate::observe::metrics::Metrics;
use crate::store::checkpoint::{self, Saved};
use crate::store::run_folder::RunFolder;
use crate::train::assemble::assemble;
use crate::train::environments::Environments;
use crate::train::evaluation::{Evaluated, Evaluations};
use crate::train::fail_points;
use crate::train::provenance::{Provenance, WeightsOrigin};
use crate::train::reward_terms;
use crate::train::trainer::collect::{Collected, ProgressMonitor};
use crate::train::trainer::divergence::Divergence;

/// Receives a run's events.
pub type Observer = Box<dyn FnMut(&Event) + Send>;

/// The state of a run between two iterations.
pub struct Trainer {
    /// The settings of the run.
    pub(crate) launch: Launch,
    pub(crate) observations: ObservationMoments,
    pub(crate) algorithm: Box<dyn Algorithm>,
    pub(crate) surprise: Surprise,
    pub(crate) environments: Environments,
    pub(crate) evaluations: Evaluations,
    pub(crate) iteration: u64,
    /// The newest policies, encoded for actors.
    pub(crate) policy: Bytes,
    pub(crate) folder: RunFolder,
    pub(crate) metrics: Metrics,
    pub(crate) provenance: Provenance,
    pub(crate) saved: Option<Saved>,
    pub(crate) failed_saves: u32,
    pub(crate) pool: ThreadPool,
}

/// Connections of a trainer to the rest of the learner.
pub struct Outside {
    /// Leases work to actors and receives their results.
    pub exchange: Arc<Exchange>,
    /// Receives the run's events, after the exchange.
    pub observer: Observer,
    /// Whether to stop after the last finished iteration.
    pub stop: Box<dyn Fn() -> bool + Send>,
}

/// A trainer whose first slots are open.
pub struct RunningTrainer {
    trainer: Trainer,
    outside: Outside,
    progress: ProgressMonitor,
    /// Rollouts that arrived while the trainer waited for an evaluation.
    arrived: Option<Collected>,
    /// The weights used for the rollouts of the open iteration.
    behaviour: Option<WeightsName>,
    /// Whether idle actor threads have been reported.
    advised: bool,
    divergence: Divergence,
    /// When the last iteration ended.
    ended: Instant,
}

/// The result of an update.
struct Update {
    report: Report,
    /// The weights after it.
    weights: NamedArrays,
    density_secs: f64,
    update_secs: f64,
}

impl Trainer {
    /// Environment steps of all finished iterations.
    #[must_use]
    pub fn env_steps(&self) -> u64 {
        self.steps_after(self.iteration)
    }

    /// Publishes the newest policies and opens the slots of the next iteration.
    ///
    /// # Errors
    /// The policies cannot be published.
    pub fn begin(self, outside: Outside) -> Result<RunningTrainer, LearnerError> {
        let mut running = RunningTrainer {
            trainer: self,
            outside,
            progress: ProgressMonitor::new(Instant::now()),
            arrived: None,
            behaviour: None,
            advised: false,
            divergence: Divergence::default(),
            ended: Instant::now(),
        };
        running.begin()?;
        Ok(running)
    }

    fn steps_after(&self, iteration: u64) -> u64 {
        iteration * self.launch.config.environments.steps_per_iteration()
    }
}

impl RunningTrainer {
    /// Trains to the last iteration, or until stopped. Both end with a checkpoint.
    ///
    /// # Errors
    /// Training failed; the run can be resumed from the last checkpoint.
    pub fn train(mut self) -> Result<Summary, LearnerError> {
        let result = self.run();
        if let Err(LearnerError::Exchange(_)) = &result {
            // The trainer's state is still that of the last finished iteration.
            if let Err(failed) = self.save_now() {
                tracing::error!("the last checkpoint failed: {failed}");
            }
        }
        result
    }

    fn run(&mut self) -> Result<Summary, LearnerError> {
        self.evaluate_if_due()?;
        while self.trainer.iteration < self.trainer.launch.until {
            let collected = self.collect()?;
            let Some(collected) = collected else { break };
            self.emit(&Event::Stage(Stage::Update));
            fail_points::abort_at("after-collect", self.trainer.iteration);
            let batch = assemble(&self.outside.exchange.run, &collected.rollouts);
            self.trainer.environments.advance(&batch, &collected.rollouts);
            let update = self.trainer.update(&batch)?;
            self.trainer.iteration += 1;
            self.publish()?;
            self.lease();
            fail_points::abort_at("after-publish", self.trainer.iteration);
            self.record(&collected, &update)?;
            self.evaluate_if_due()?;
            self.save_if_due()?;
        }
        self.end()
    }

    /// Begins a new run or resumes one from a checkpoint.
    fn begin(&mut self) -> Result<(), LearnerError> {
        if let Some(evaluated) = self.trainer.evaluations.outstanding().cloned() {
            self.open_evaluation(&evaluated)?;
        }
        self.publish()?;
        self.lease();
        Ok(())
    }

    /// Writes the last checkpoint, then waits for the last evaluation.
    fn end(&mut self) -> Result<Summary, LearnerError> {
        let saved = self.save_now()?;
        let complete = self.trainer.iteration >= self.trainer.launch.until;
        let stopped_early = !complete || !self.settle_evaluation()?;
        self.note_foreign_actors(self.outside.exchange.run_snapshot().foreign_actors);
        self.trainer.metrics.sync()?;
        self.trainer.folder.demand_in_place()?;
        if let Some(error) = self.outside.exchange.failure() {
            return Err(error.into());
        }
        Ok(Summary {
            iteration: self.trainer.iteration,
            env_steps: self.trainer.env_steps(),
            checkpoint: saved.path,
            stopped_early,
            weights_sha256: saved.weights_sha256,
            state_sha256: saved.state_sha256,
        })
    }

    /// Publishes the newest policies for actors.
    fn publish(&mut self) -> Result<(), LearnerError> {
        let version = PolicyVersion(self.trainer.iteration);
        self.outside.exchange.publish(version, self.trainer.policy.clone())?;
        Ok(())
    }

    /// Opens the slots of the next iteration, if there is one, for rollouts with the weights just published.
    fn lease(&mut self) {
        let iteration = self.trainer.iteration;
        if iteration < self.trainer.launch.until {
            let per_slot = self.slot_size();
            let slots = self.trainer.environments.work(iteration, per_slot);
            let exchange = &self.outside.exchange;
            let weights = PolicyVersion(iteration);
            self.behaviour = Some(exchange.open_iteration(iteration, weights, slots));
            self.emit(&Event::Collecting { iteration, env_steps: self.trainer.env_steps() });
        }
    }

    /// Environments of each slot of the next iteration, for the actor threads that are connected now.
    fn slot_size(&self) -> usize {
        let exchange = &self.outside.exchange;
        let threads = exchange.threads();
        let most = exchange.run.environments_per_slot as usize;
        self.trainer.launch.config.environments.slot_size(threads, most)
    }

    /// Writes metrics and provenance of the iteration just finished.
    fn record(&mut self, collected: &Collected, update: &Update) -> Result<(), LearnerError> {
        let now = self.outside.exchange.run_snapshot();
        let begun = std::mem::replace(&mut self.ended, Instant::now());
        self.note_foreign_actors(now.foreign_actors);
        let trainer = &mut self.trainer;
        trainer.folder.demand_in_place()?;
        let mut metrics = trainer.surprise.report();
        metrics.extend(update.report.iter().cloned());
        // An external environment may have its own time limit; reaching it is not a fault.
        if !self.outside.exchange.run.task_settings.is_empty() {
            metrics.push(("environment_faults".to_owned(), trainer.environments.faults as f64));
        }
        let names = &self.outside.exchange.run.environment.reward_terms;
        metrics.extend(reward_terms::means_per_step(names, &collected.rollouts));
        metrics.push(("checkpoints_failed".to_owned(), trainer.failed_saves.into()));
        let report = IterationReport {
            iteration: trainer.iteration,
            env_steps: trainer.env_steps(),
            iteration_secs: (self.ended - begun).as_secs_f64(),
            rollout_secs: collected.secs,
            update_secs: update.update_secs,
            density_secs: update.density_secs,
            episode_return: trainer.environments.mean_return(),
            actors: now.status.actors,
            messages_refused: now.status.messages_refused,
            leases_reissued: now.status.leases_reissued,
            metrics,
        };
        trainer.metrics.iteration(&report)?;
        trainer.trace(collected.behaviour, &collected.rollouts, update)?;
        self.advise(report.actors);
        self.report_divergence();
        self.report_instability(&report);
        self.emit(&Event::Iteration(report));
        Ok(())
    }

    /// Records in the manifest that results of actors without a fingerprint count, if so many do. Retried after every
    /// iteration until it succeeds.
    fn note_foreign_actors(&self, foreign: u64) {
        if foreign > 0
            && let Err(error) = self.trainer.folder.note_foreign_actors()
        {
            tracing::error!(
                "cannot record foreign actors in the manifest: {error}; retrying after the next iteration"
            );
        }
    }

    /// Logs once that there are more actor threads than an iteration can have slots.
    fn advise(&mut self, actors: u64) {
        let advice = idle::advice(actors, &self.trainer.launch.config.environments);
        if let Some(advice) = advice.filter(|_| !self.advised) {
            tracing::info!("{advice}");
            self.advised = true;
        }
    }

    /// Begins an evaluation of the newest policies if it is due, after waiting for the outstanding one.
    fn evaluate_if_due(&mut self) -> Result<(), LearnerError> {
        if !self.trainer.evaluations.due(self.trainer.iteration) || !self.settle_evaluation()? {
            return Ok(());
        }
        let iteration = self.trainer.iteration;
        let policy = self.trainer.policy.clone();
        let evaluated = Evaluated { iteration, policy };
        self.open_evaluation(&evaluated)?;
        self.trainer.evaluations.begin(evaluated);
        Ok(())
    }

    fn open_evaluation(&mut self, evaluated: &Evaluated) -> Result<(), LearnerError> {
        let version = PolicyVersion(evaluated.iteration);
        let exchange = &self.outside.exchange;
        // The exchange drops weights that no open work names, so they are published again.
        exchange.publish(version, evaluated.policy.clone())?;
        let episodes = self.trainer.evaluations.episodes(evaluated.iteration);
        exchange.open_evaluation(evaluated.iteration, version, episodes);
        Ok(())
    }

    fn emit(&mut self, event: &Event) {
        self.outside.exchange.observe(event);
        (self.outside.observer)(event);
    }
}

impl Trainer {
    /// Scales observations as in acting, fits densities on `D_k` (Eq. 2), relabels rewards (Eq. 4, 9), and updates
    /// policies and critics (Eq. 10). All arithmetic runs in the run's thread pool.
    fn update(&mut self, batch: &Batch) -> Result<Update, LearnerError> {
        let begin = Instant::now();
        fail_points::abort_soon_at("mid-update", self.iteration);
        let Self { launch, pool, observations, surprise, algorithm, iteration, .. } = self;
        let seen = observations.seen(batch);
        pool.install(|| surprise.refit(&seen, *iteration))?;
        let rewards = pool.install(|| surprise.relabel(&seen));
        let density_secs = begin.elapsed().as_secs_f64();
        let decay = launch.training.update.learning_rate_decay;
        algorithm.scale_learning_rates(decay.share(*iteration, launch.iterations));
        let update = || algorithm.update(&seen, &rewards, *iteration);
        let report = pool.install(update);
        let next = *iteration + 1;
        let weights = algorithm.weights()?;
        // An update that fails because of such weights does not say which.
        if let Some(found) = divergence::infinite(&weights) {
            return Err(divergence::refusal(&launch.training, next, &found));
        }
        let report = report?;
        pool.install(|| observations.take_in(batch));
        let policies = self.encode_policies(next)?;
        if let Some(found) = divergence::unusable(&policies, batch) {
            return Err(divergence::refusal(&self.launch.training, next, &found));
        }
        let update_secs = begin.elapsed().as_secs_f64();
        Ok(Update { report, weights, density_secs, update_secs })
    }

    /// Encodes the policies for the rollouts of an iteration.
    pub(crate) fn encode_policies(&mut self, iteration: u64) -> Result<PolicySnapshot, MarlError> {
        let share = self.launch.policy.noise_share(self.steps_after(iteration));
        self.algorithm.scale_noise(share);
        let snapshot = self.observations.snapshot(self.algorithm.snapshot()?);
        self.policy = Bytes::from(snapshot.to_bytes()?);
        Ok(snapshot)
    }

    fn trace(
        &mut self,
        behaviour: WeightsName,
        rollouts: &[SlotRollout],
        Update { report, weights, .. }: &Update,
    ) -> Result<(), LearnerError> {
        let weights = checkpoint::weights_sha256(weights);
        let density: NamedArrays = self.surprise.arrays()?;
        self.provenance.iteration(&WeightsOrigin {
            iteration: self.iteration,
            behaviour,
            begun_again: &self.environments.begun_again,
            rollouts,
            density: &density,
            weights_sha256: &weights,
            report,
        })?;
        Ok(())
    }
}
