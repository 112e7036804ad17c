//! The run of this process as the page and Prometheus show it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::{Value, json};

use super::{EpisodeName, RunFacts, Runs, ShownRun};
use crate::launch::Launch;
use crate::lease::exchange::{Exchange, status_json};
use crate::observe::metrics::Curves;
use crate::observe::snapshot::{FilmedEpisode, RunSnapshot};

/// Constants of the run.
#[derive(Clone, Debug)]
pub(crate) struct Facts {
    /// Those that the page shows.
    pub(super) shown: RunFacts,
    /// Iterations from one checkpoint to the next.
    pub(super) checkpoint_every: u64,
    /// Uses of each environment step in the optimiser steps of an agent.
    pub(super) sample_reuse: f64,
    /// Iterations that were finished when this learner started.
    pub(super) resumed_at: u64,
}

impl Facts {
    /// The constants of a run that starts or is resumed after the iteration `resumed_at`.
    pub(crate) fn of(launch: &Launch, resumed_at: u64) -> Self {
        let steps = launch.config.environments.steps_per_iteration();
        let shown = RunFacts {
            manifest: launch.manifest(),
            settings: launch.config_toml.clone(),
            command: launch.command.clone(),
            iterations: launch.iterations,
            env_steps: launch.iterations.saturating_mul(steps),
        };
        Self {
            shown,
            checkpoint_every: launch.config.checkpoint.every,
            sample_reuse: launch.training.sample_reuse(),
            resumed_at,
        }
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

impl Runs for RunView {
    fn look(&self) -> Vec<ShownRun> {
        let run = self.exchange.run_snapshot();
        let curves = self.curves().clone();
        let evaluated =
            |film: &Arc<FilmedEpisode>| (film.version.0, Some(film.result.extrinsic_return));
        vec![ShownRun {
            name: run.status.run_id.clone(),
            live: Some(status(&run)),
            policies: run.films.iter().map(evaluated).collect(),
            episodes: 1,
            version: curves.lines(),
            curves: Arc::new(curves),
            group: None,
            trouble: None,
        }]
    }

    fn facts(&self, _run: usize) -> Result<RunFacts, String> {
        Ok(self.facts.shown.clone())
    }

    fn film(&self, _run: usize, name: EpisodeName) -> Result<Option<Arc<FilmedEpisode>>, String> {
        let films = &self.exchange.run_snapshot().films;
        let film = films.iter().find(|film| film.version.0 == name.iteration);
        let why = || format!("the film of iteration {} is no longer kept", name.iteration);
        film.cloned().map(Some).ok_or_else(why)
    }
}

/// The current status of the run.
fn status(run: &RunSnapshot) -> Value {
    json!({
        "status": status_json(&run.status),
        "stage": run.stage.name(),
        "waiting": run.waiting,
        "secs": run.phase_secs().map(BTreeMap::from),
        "checkpoint": run.checkpoint.map(|written| written.iteration),
        "checkpoint_failures": run.checkpoint_failures,
    })
}
