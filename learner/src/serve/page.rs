//! The web page of a run, or of several: an HTTP server for browsers and Prometheus. Its requests are read-only and never
//! delay a run.

mod answers;
mod exposition;
mod hosts;
mod server;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use security::ServerTls;
use serde_json::Value;
use tokio::net::TcpListener;

use crate::launch::Launch;
use crate::lease::exchange::Exchange;
use crate::observe::metrics::Curves;

pub use hosts::{Hosts, NotAHost};
pub(crate) use server::serve;
pub use server::serve_overlay;

/// The listening socket of the page and the accepted host names.
#[derive(Debug)]
pub struct Page {
    /// Listens for browsers.
    pub listener: TcpListener,
    /// Accepted values of the header `Host`.
    pub hosts: Hosts,
    /// With it, only clients with the role operator are answered, over TLS.
    pub tls: Option<ServerTls>,
}

/// A run whose curves the page shows together with those of other runs.
#[derive(Clone, Debug, Default)]
pub struct OverlaidRun {
    /// Its name.
    pub name: String,
    /// Name of its group, which all runs have that differ from it only in their seed; `None` if its settings are unknown.
    pub group: Option<String>,
    /// What cannot be read in its folder, if anything.
    pub trouble: Option<String>,
    /// Its curves.
    pub curves: Arc<Curves>,
}

/// The curves of several runs that the page shows together.
#[derive(Clone, Debug, Default)]
pub struct Overlay {
    /// Counts changes: with equal numbers, all runs are equal.
    pub version: u64,
    /// The runs, always in the same order.
    pub runs: Vec<OverlaidRun>,
}

/// Constants of a run.
#[derive(Clone, Debug)]
pub(crate) struct Facts {
    /// The manifest in the run folder.
    manifest: Value,
    /// Iterations of the whole run.
    iterations: u64,
    /// Environment steps of the whole run.
    env_steps: u64,
    /// Iterations from one checkpoint to the next.
    checkpoint_every: u64,
    /// Uses of each environment step in the optimiser steps of an agent.
    sample_reuse: f64,
    /// Iterations that were finished when this learner started.
    resumed_at: u64,
}

impl Facts {
    /// The constants of a run that starts or is resumed after the iteration `resumed_at`.
    pub(crate) fn of(launch: &Launch, resumed_at: u64) -> Self {
        let steps = launch.config.environments.steps_per_iteration();
        Self {
            manifest: launch.manifest(),
            iterations: launch.iterations,
            env_steps: launch.iterations.saturating_mul(steps),
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
    fn curves(&self) -> MutexGuard<'_, Curves> {
        self.curves.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
