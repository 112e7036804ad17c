//! The run's web page: an HTTP server for browsers and Prometheus. Its requests are read-only and never delay the run.

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

/// The listening socket of the page and the accepted host names.
#[derive(Debug)]
pub struct Page {
    /// Listens for browsers.
    pub listener: TcpListener,
    /// Accepted values of the header `Host`.
    pub hosts: Hosts,
}
