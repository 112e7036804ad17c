//! The run's page: what a browser and Prometheus are shown of a learner at work, over plain HTTP. Nothing that is
//! asked here can change a run, and a run waits for no viewer.

mod answers;
mod exposition;
mod hosts;
mod memory;
mod server;
mod view;

use tokio::net::TcpListener;

pub use hosts::Hosts;
pub(crate) use server::serve;
pub(crate) use view::{Facts, RunView};

/// Where the page is shown, and to whom.
#[derive(Debug)]
pub struct Page {
    /// Where browsers come in.
    pub listener: TcpListener,
    /// The names by which the page may be asked for.
    pub hosts: Hosts,
}
