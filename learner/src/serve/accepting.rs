//! Accepting connections. Accepting fails without free file descriptors; that is logged once, and retried.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::time::Instant;

/// Pause after a failed attempt.
const PAUSE: Duration = Duration::from_millis(50);
/// Shortest time between two warnings.
const WARNING_PAUSE: Duration = Duration::from_secs(10);

/// A listening socket whose failures are reported: the first one of a series, and its end.
#[derive(Debug)]
pub(crate) struct Accepting {
    listener: TcpListener,
    /// Prefix of the log messages.
    name: &'static str,
    warned: bool,
    quiet_until: Option<Instant>,
}

impl Accepting {
    /// Accepts the connections of `listener`.
    pub(crate) fn new(listener: TcpListener, name: &'static str) -> Self {
        Self { listener, name, warned: false, quiet_until: None }
    }

    /// The next connection.
    pub(crate) async fn next(&mut self) -> (TcpStream, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok(accepted) => {
                    self.succeeded();
                    return accepted;
                }
                Err(error) => {
                    self.failed(&error);
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    }

    fn failed(&mut self, error: &io::Error) {
        let now = Instant::now();
        if self.warned || self.quiet_until.is_some_and(|until| now < until) {
            return;
        }
        (self.warned, self.quiet_until) = (true, Some(now + WARNING_PAUSE));
        let name = self.name;
        tracing::warn!("{name}: cannot accept connections: {error}; retrying until it succeeds");
    }

    fn succeeded(&mut self) {
        if std::mem::take(&mut self.warned) {
            tracing::info!("{}: accepting connections again", self.name);
        }
    }
}
