//! Sink of a live view. Messages have wall-clock timestamps, and simulated time passes in real time.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use foxglove::Context;
use tokio::runtime::Handle;

use super::topic_cache::TopicCache;
use crate::error::RecordError;
use crate::sink::{Channel, Schema, Sink};

/// Sink that sends messages in real time.
pub(super) struct LiveSink {
    context: Arc<Context>,
    network: Handle,
    cache: Arc<TopicCache>,
    /// Time of messages, nanoseconds since 1970.
    nanos: u64,
    /// Instant at which `nanos` is reached.
    due: Instant,
}

impl LiveSink {
    /// Creates a sink with the current time.
    pub(super) fn new(context: Arc<Context>, network: Handle, cache: Arc<TopicCache>) -> Self {
        Self { context, network, cache, nanos: now_nanos(), due: Instant::now() }
    }

    /// Sets the clock, which stops while nothing is shown, to the current time; never backwards.
    pub(super) fn set_clock(&mut self) {
        self.nanos = self.nanos.max(now_nanos());
        self.due = Instant::now();
    }
}

impl LiveSink {
    /// Creates a channel of JSON objects; `schema` is a JSON schema with a title.
    pub(super) fn json_channel(
        &mut self,
        topic: &str,
        schema: &serde_json::Value,
    ) -> Result<Channel, RecordError> {
        let name = schema["title"].as_str().unwrap_or_default();
        let data = schema.to_string().into_bytes();
        let schema = Schema { name, encoding: "jsonschema", data: &data, messages: "json" };
        self.channel(topic, &schema, &BTreeMap::new())
    }
}

impl Sink for LiveSink {
    fn channel(
        &mut self,
        topic: &str,
        schema: &Schema<'_>,
        about: &BTreeMap<String, String>,
    ) -> Result<Channel, RecordError> {
        let server = (&self.context, &self.network);
        let place = self.cache.add(server, topic, schema, about).map_err(|error| {
            RecordError::Message { topic: topic.to_owned(), why: error.to_string() }
        })?;
        Ok(Channel::new(u16::try_from(place).expect("a handful of topics"), topic))
    }

    fn write(&mut self, channel: &mut Channel, data: &[u8]) -> Result<(), RecordError> {
        self.cache.show(channel.id().into(), self.nanos, data);
        Ok(())
    }

    fn nanos(&self) -> u64 {
        self.nanos
    }

    /// Waits until the new time. If it has already passed, later times are relative to now instead of catching up.
    fn advance(&mut self, nanos: u64) {
        self.nanos += nanos;
        self.due += Duration::from_nanos(nanos);
        match self.due.checked_duration_since(Instant::now()) {
            Some(early) => std::thread::sleep(early),
            None => self.due = Instant::now(),
        }
    }
}

/// Current wall-clock time, nanoseconds since 1970.
pub(super) fn now_nanos() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
