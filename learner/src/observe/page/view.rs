//! The data of the run's page: constants of the run, the exchange's snapshot, and the metrics' curves.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::Value;

use crate::exchange::Exchange;
use crate::launch::Launch;
use crate::metrics::Curves;

/// Constants of a run.
#[derive(Clone, Debug)]
pub(crate) struct Facts {
    /// The manifest in the run folder.
    pub(super) manifest: Value,
    /// Iterations of the whole run.
    pub(super) iterations: u64,
    /// Environment steps of the whole run.
    pub(super) env_steps: u64,
    /// Iterations from one checkpoint to the next.
    pub(super) checkpoint_every: u64,
    /// Uses of each environment step in the optimiser steps of an agent.
    pub(super) sample_reuse: f64,
    /// Iterations that were finished when this learner started.
    pub(super) resumed_at: u64,
}

impl Facts {
    /// The constants of a run that is about to start.
    pub(crate) fn of(launch: &Launch) -> Self {
        let steps = launch.config.environments.steps_per_iteration();
        Self {
            manifest: launch.manifest(),
            iterations: launch.iterations,
            env_steps: launch.iterations.saturating_mul(steps),
            checkpoint_every: launch.config.checkpoint.every,
            sample_reuse: launch.training.sample_reuse(),
            resumed_at: 0,
        }
    }

    /// The same for a run that is resumed after `iteration`.
    pub(crate) fn resumed_at(self, iteration: u64) -> Self {
        Self { resumed_at: iteration, ..self }
    }
}

/// Everything that the page shows.
#[derive(Debug)]
pub(crate) struct RunView {
    pub(crate) facts: Facts,
    pub(crate) exchange: Arc<Exchange>,
    /// Locked for one lookup or one copy, so that the trainer, which adds to them, never waits for a response.
    pub(crate) curves: Arc<Mutex<Curves>>,
}

impl RunView {
    /// The curves. Clone them before any longer work.
    pub(super) fn curves(&self) -> MutexGuard<'_, Curves> {
        self.curves.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
