//! What is known of a run at work, gathered from the exchange, the metrics and the trainer's events.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::Value;

use crate::event::{Event, IterationReport, Stage};
use crate::exchange::Exchange;
use crate::launch::Launch;
use crate::metrics::Curves;

/// What is known before a run starts.
#[derive(Clone, Debug)]
pub(crate) struct Facts {
    /// As in the run folder.
    pub(super) manifest: Value,
    /// Of the whole run.
    pub(super) iterations: u64,
    /// Of the whole run.
    pub(super) env_steps: u64,
    /// Iterations from one checkpoint to the next.
    pub(super) checkpoint_every: u64,
    /// Times that an environment step goes into an optimiser step of an agent.
    pub(super) sample_reuse: f64,
    /// The iteration after which this learner took the run up.
    pub(super) taken_up_at: u64,
}

impl Facts {
    /// The facts of a run that is about to be started or gone on with.
    pub(crate) fn of(launch: &Launch) -> Self {
        let steps = launch.config.environments.steps_per_iteration();
        Self {
            manifest: launch.manifest(),
            iterations: launch.iterations,
            env_steps: launch.iterations.saturating_mul(steps),
            checkpoint_every: launch.config.checkpoint.every,
            sample_reuse: launch.training.sample_reuse(),
            taken_up_at: 0,
        }
    }

    /// The same for a run that goes on after `iteration`.
    pub(crate) fn taken_up_at(self, iteration: u64) -> Self {
        Self { taken_up_at: iteration, ..self }
    }
}

/// Everything that is shown.
#[derive(Debug)]
pub(crate) struct Board {
    pub(super) facts: Facts,
    pub(super) exchange: Arc<Exchange>,
    curves: Arc<Mutex<Curves>>,
    told: Mutex<Told>,
}

/// What the trainer's events said.
#[derive(Clone, Debug)]
pub(super) struct Told {
    pub(super) stage: Stage,
    /// The last iteration.
    pub(super) report: Option<IterationReport>,
    /// The last checkpoint.
    pub(super) checkpoint: Option<Written>,
    /// Checkpoints that could not be written since the learner started.
    pub(super) checkpoint_failures: u64,
    /// Episodes that a fault of their world cut, since the learner started.
    pub(super) environment_faults: u64,
    /// Updates that were left out because returns were no finite numbers, since the learner started.
    pub(super) updates_skipped: u64,
    /// What is missing, while nothing comes in.
    pub(super) waiting: Option<String>,
}

/// A checkpoint on disk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Written {
    pub(super) iteration: u64,
    pub(super) secs: f64,
    pub(super) bytes: u64,
}

impl Board {
    /// A board on which nothing has happened yet.
    pub(crate) fn new(facts: Facts, exchange: Arc<Exchange>, curves: Arc<Mutex<Curves>>) -> Self {
        let told = Mutex::new(Told {
            stage: Stage::Collect,
            report: None,
            checkpoint: None,
            checkpoint_failures: 0,
            environment_faults: 0,
            updates_skipped: 0,
            waiting: None,
        });
        Self { facts, exchange, curves, told }
    }

    /// Keeps what an event says.
    pub(crate) fn observe(&self, event: &Event) {
        self.lock().take_in(event);
    }

    /// What the events said so far.
    pub(super) fn told(&self) -> Told {
        self.lock().clone()
    }

    /// All curves as they are now. A copy, so that the trainer never waits for whoever writes them out.
    pub(super) fn curves(&self) -> Curves {
        self.lock_curves().clone()
    }

    /// Grows whenever a curve does.
    pub(super) fn lines(&self) -> u64 {
        self.lock_curves().lines()
    }

    /// The newest value of a figure.
    pub(super) fn newest(&self, figure: &str) -> Option<f64> {
        self.lock_curves().newest(figure)
    }

    fn lock_curves(&self) -> MutexGuard<'_, Curves> {
        self.curves.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lock(&self) -> MutexGuard<'_, Told> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Told {
    /// How long the parts of the last iteration took; a checkpoint counts to the iteration after which it was written.
    pub(super) fn secs(&self) -> Option<[(&'static str, f64); 4]> {
        let report = self.report.as_ref()?;
        let saved = self.checkpoint.filter(|written| written.iteration == report.iteration);
        Some([
            ("collect", report.rollout_secs),
            ("refit", report.density_secs),
            ("update", report.update_secs - report.density_secs),
            ("save", saved.map_or(0.0, |written| written.secs)),
        ])
    }

    fn take_in(&mut self, event: &Event) {
        match event {
            Event::Stage(stage) => self.stage = *stage,
            Event::Iteration(report) => self.iteration(report),
            Event::Collecting { .. } | Event::Paused => self.waiting = None,
            Event::Waiting { reason, .. } => self.waiting = Some(reason.clone()),
            Event::Checkpoint { iteration, secs, bytes, .. } => {
                let (iteration, secs, bytes) = (*iteration, *secs, *bytes);
                self.checkpoint = Some(Written { iteration, secs, bytes });
            }
            Event::CheckpointFailed { .. } => self.checkpoint_failures += 1,
            Event::Evaluation { .. } | Event::Resumed => {}
        }
    }

    fn iteration(&mut self, report: &IterationReport) {
        self.waiting = None;
        self.environment_faults += count(report, "environment_faults");
        self.updates_skipped += count(report, "losses/update_skipped");
        self.report = Some(report.clone());
    }
}

/// A figure of an iteration that counts something; 0 where it is missing.
fn count(report: &IterationReport, name: &str) -> u64 {
    let found = report.metrics.iter().find(|(figure, _)| figure == name);
    found.map_or(0, |(_, value)| *value as u64)
}
