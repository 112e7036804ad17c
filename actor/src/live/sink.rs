//! A live view as a sink of episodes: its messages bear the time of day, and simulated time passes as fast as real time.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use foxglove::Context;
use tokio::runtime::Handle;

use super::shelf::Shelf;
use crate::recording::RecordError;
use crate::recording::sink::{Channel, Schema, Sink};

/// Shows at the pace of real time.
pub(super) struct LiveSink {
    context: Arc<Context>,
    network: Handle,
    shelf: Arc<Shelf>,
    /// Since 1970.
    nanos: u64,
    /// When that time has come.
    due: Instant,
}

impl LiveSink {
    /// At the time that it is.
    pub(super) fn new(context: Arc<Context>, network: Handle, shelf: Arc<Shelf>) -> Self {
        Self { context, network, shelf, nanos: now_nanos(), due: Instant::now() }
    }

    /// Sets the clock, which stood still while nothing was shown; never back.
    pub(super) fn set_clock(&mut self) {
        self.nanos = self.nanos.max(now_nanos());
        self.due = Instant::now();
    }
}

impl Sink for LiveSink {
    fn channel(&mut self, topic: &str, schema: &Schema<'_>) -> Result<Channel, RecordError> {
        let place =
            self.shelf.add((&self.context, &self.network), topic, schema).map_err(|error| {
                RecordError::Message { topic: topic.to_owned(), why: error.to_string() }
            })?;
        Ok(Channel::new(u16::try_from(place).expect("a handful of topics"), topic))
    }

    fn write(&mut self, channel: &mut Channel, data: &[u8]) -> Result<(), RecordError> {
        self.shelf.show(channel.id().into(), self.nanos, data);
        Ok(())
    }

    fn nanos(&self) -> u64 {
        self.nanos
    }

    /// Waits until it is so late. Whoever is late already goes on from there, rather than hurry.
    fn advance(&mut self, nanos: u64) {
        self.nanos += nanos;
        self.due += Duration::from_nanos(nanos);
        match self.due.checked_duration_since(Instant::now()) {
            Some(early) => std::thread::sleep(early),
            None => self.due = Instant::now(),
        }
    }
}

/// The time of day, nanoseconds since 1970.
pub(super) fn now_nanos() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
