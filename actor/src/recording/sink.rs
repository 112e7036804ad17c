//! Where messages about an episode go, whatever takes them: channels with schemas, and a clock that stamps what is
//! written on them.

use foxglove::Encode;
use foxglove::messages::Timestamp;

use super::RecordError;

const NANOS_PER_SEC: u64 = 1_000_000_000;

/// A topic of a sink.
#[derive(Clone, Debug)]
pub(crate) struct Channel {
    pub(super) id: u16,
    pub(super) topic: String,
    pub(super) sequence: u32,
    buffer: Vec<u8>,
}

impl Channel {
    /// The sink's channel number `id`.
    pub(crate) fn new(id: u16, topic: &str) -> Self {
        Self { id, topic: topic.to_owned(), sequence: 0, buffer: Vec::new() }
    }

    /// Its number in the sink.
    pub(crate) fn id(&self) -> u16 {
        self.id
    }
}

/// How a channel's messages are written.
pub(crate) struct Schema<'a> {
    /// The type's full name.
    pub(crate) name: &'a str,
    /// Of the schema.
    pub(crate) encoding: &'a str,
    /// The schema.
    pub(crate) data: &'a [u8],
    /// Of the messages.
    pub(crate) messages: &'a str,
}

/// Takes messages.
pub(crate) trait Sink {
    /// A channel; its schema goes with it.
    fn channel(&mut self, topic: &str, schema: &Schema<'_>) -> Result<Channel, RecordError>;

    /// An encoded message, now.
    fn write(&mut self, channel: &mut Channel, data: &[u8]) -> Result<(), RecordError>;

    /// The time that messages bear, nanoseconds.
    fn nanos(&self) -> u64;

    /// Lets simulated time pass.
    fn advance(&mut self, nanos: u64);

    /// A channel of one of Foxglove's messages.
    fn foxglove_channel<M: Encode>(&mut self, topic: &str) -> Result<Channel, RecordError> {
        let missing =
            || RecordError::Message { topic: topic.to_owned(), why: "no schema".to_owned() };
        let schema = M::get_schema().ok_or_else(missing)?;
        let messages = M::get_message_encoding();
        let (name, encoding) = (schema.name.as_str(), schema.encoding.as_str());
        self.channel(topic, &Schema { name, encoding, data: &schema.data, messages: &messages })
    }

    /// A channel of JSON objects; `schema` is a JSON schema with a title.
    fn json_channel(
        &mut self,
        topic: &str,
        schema: &serde_json::Value,
    ) -> Result<Channel, RecordError> {
        let name = schema["title"].as_str().unwrap_or_default();
        let data = schema.to_string().into_bytes();
        self.channel(topic, &Schema { name, encoding: "jsonschema", data: &data, messages: "json" })
    }

    /// One of Foxglove's messages, now.
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

    /// The time that messages bear, as Foxglove's messages tell it.
    fn now(&self) -> Timestamp {
        let nanos = self.nanos();
        Timestamp::new((nanos / NANOS_PER_SEC) as u32, (nanos % NANOS_PER_SEC) as u32)
    }

    /// Lets a second pass before the next episode.
    fn pause(&mut self) {
        self.advance(NANOS_PER_SEC);
    }
}
