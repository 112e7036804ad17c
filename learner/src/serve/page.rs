//! The web page of runs, of the one of this process or of those in folders: an HTTP server for browsers and Prometheus. Its
//! requests are read-only and never delay a run.

mod answers;
mod exposition;
mod hosts;
mod live;
mod server;

use std::sync::Arc;

use security::ServerTls;
use serde::Serialize;
use serde_json::Value;
use tokio::net::TcpListener;

use crate::observe::metrics::Curves;
use crate::observe::snapshot::FilmedEpisode;

pub use hosts::{Hosts, NotAHost};
pub(crate) use live::{Facts, RunView};
pub use server::serve;
pub(crate) use server::serve_live;

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

/// The runs that a page shows. The methods are called on blocking threads.
pub trait Runs: Send + Sync {
    /// The runs now, always in the same order.
    fn look(&self) -> Vec<ShownRun>;

    /// Constants of the run with this index.
    ///
    /// # Errors
    /// Why they cannot be read.
    fn facts(&self, run: usize) -> Result<RunFacts, String>;

    /// The start of an episode of a run's policies after an iteration; `None` if it must be requested again, because
    /// another one is being played.
    ///
    /// # Errors
    /// Why it cannot be shown.
    fn film(&self, run: usize, episode: EpisodeName) -> Result<Option<Arc<FilmedEpisode>>, String>;
}

/// An episode of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeName {
    /// Iteration of the policies.
    pub iteration: u64,
    /// Its index in an evaluation of these policies.
    pub index: u32,
}

/// A run at one time.
#[derive(Clone, Debug, Default)]
pub struct ShownRun {
    /// Its name.
    pub name: String,
    /// Name of its group, which all runs have that differ from it only in their seed; `None` if its settings are unknown.
    pub group: Option<String>,
    /// What cannot be read in its folder, if anything.
    pub trouble: Option<String>,
    /// Its curves.
    pub curves: Arc<Curves>,
    /// Counts changes of the curves: with equal numbers, they are equal.
    pub version: u64,
    /// Stage, leases and so on, of the run of this process.
    pub live: Option<Value>,
    /// The policies of which episodes can be shown, in order: iteration, and return if they were evaluated.
    pub policies: Vec<(u64, Option<f64>)>,
    /// Number of episodes that can be shown of each.
    pub episodes: u32,
}

/// Constants of a run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RunFacts {
    /// The manifest in the run folder.
    pub manifest: Value,
    /// All settings as TOML.
    pub settings: String,
    /// Command that begins a run with the same settings.
    pub command: String,
    /// Iterations of the whole run.
    pub iterations: u64,
    /// Environment steps of the whole run.
    pub env_steps: u64,
}
