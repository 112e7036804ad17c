//! The web page of a run, or of several: an HTTP server for browsers and Prometheus. Its requests are read-only and never
//! delay a run.

mod answers;
mod exposition;
mod hosts;
mod memory;
mod server;
mod view;

use std::sync::Arc;

use security::ServerTls;
use tokio::net::TcpListener;

use crate::metrics::Curves;

pub use hosts::{Hosts, NotAHost};
pub(crate) use server::serve;
pub use server::serve_overlay;
pub(crate) use view::{Facts, RunView};

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
