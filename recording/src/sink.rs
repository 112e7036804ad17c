//! The interface of message sinks: channels with schemas, and a clock for their timestamps.

use std::collections::BTreeMap;

use foxglove::Encode;
use foxglove::messages::Timestamp;

use crate::error::RecordError;

const NANOS_PER_SEC: u64 = 1_000_000_000;

/// A channel of a sink.
#[derive(Clone, Debug)]
pub(crate) struct Channel {
    pub(crate) id: u16,
    pub(crate) topic: String,
    pub(crate) sequence: u32,
    buffer: Vec<u8>,
}

impl Channel {
    /// Creates a channel with the sink's id `id`.
    pub(crate) fn new(id: u16, topic: &str) -> Self {
        Self { id, topic: topic.to_owned(), sequence: 0, buffer: Vec::new() }
    }

    /// Id of the channel in its sink.
    pub(crate) fn id(&self) -> u16 {
        self.id
    }
}

/// Schema and encoding of a channel's messages.
pub(crate) struct Schema<'a> {
    /// Full name of the message type.
    pub(crate) name: &'a str,
    /// Schema encoding.
    pub(crate) encoding: &'a str,
    /// Encoded schema.
    pub(crate) data: &'a [u8],
    /// Message encoding.
    pub(crate) messages: &'a str,
}

/// A destination of messages.
pub(crate) trait Sink {
    /// Creates a channel with a schema and metadata.
    fn channel(
        &mut self,
        topic: &str,
        schema: &Schema<'_>,
        about: &BTreeMap<String, String>,
    ) -> Result<Channel, RecordError>;

    /// Writes an encoded message with the current time.
    fn write(&mut self, channel: &mut Channel, data: &[u8]) -> Result<(), RecordError>;

    /// Current time of messages, nanoseconds.
    fn nanos(&self) -> u64;

    /// Advances simulated time.
    fn advance(&mut self, nanos: u64);

    /// Creates a channel for a Foxglove message type.
    fn foxglove_channel<M: Encode>(&mut self, topic: &str) -> Result<Channel, RecordError> {
        let missing =
            || RecordError::Message { topic: topic.to_owned(), why: "no schema".to_owned() };
        let schema = M::get_schema().ok_or_else(missing)?;
        let messages = M::get_message_encoding();
        let (name, encoding) = (schema.name.as_str(), schema.encoding.as_str());
        let schema = Schema { name, encoding, data: &schema.data, messages: &messages };
        self.channel(topic, &schema, &BTreeMap::new())
    }

    /// Writes a Foxglove message with the current time.
    fn foxglove<M: Encode>(
        &mut self,
        channel: &mut Channel,
        message: &M,
    ) -> Result<(), RecordError> {
        let mut buffer = std::mem::take(&mut channel.buffer);
        buffer.clear();
        let encoded = message.encode(&mut buffer).map_err(|error| RecordError::Message {
            topic: channel.topic.clone(),
            why: error.to_string(),
        });
        let written = encoded.and_then(|()| self.write(channel, &buffer));
        channel.buffer = buffer;
        written
    }

    /// Current time of messages as a Foxglove timestamp.
    fn now(&self) -> Timestamp {
        let nanos = self.nanos();
        Timestamp::new((nanos / NANOS_PER_SEC) as u32, (nanos % NANOS_PER_SEC) as u32)
    }

    /// Advances time by a second before the next episode.
    fn pause(&mut self) {
        self.advance(NANOS_PER_SEC);
    }
}
