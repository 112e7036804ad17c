//! An MCAP file in the making, with the simulated clock that stamps its messages.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, IntoInnerError, Seek, Write};

use foxglove::Encode;
use foxglove::messages::Timestamp;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};

use super::RecordError;

/// Simulated time between two episodes, nanoseconds.
const PAUSE_NANOS: u64 = 1_000_000_000;
/// Bytes of a chunk before it is compressed.
const CHUNK_BYTES: u64 = 1 << 20;

/// A topic of the file.
#[derive(Clone, Debug)]
pub(crate) struct Channel {
    id: u16,
    topic: String,
    sequence: u32,
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

/// The file. Chunks are compressed and carry checksums.
pub(crate) struct McapFile<W: Write + Seek> {
    writer: Writer<W>,
    nanos: u64,
    messages: u64,
    buffer: Vec<u8>,
}

impl<W: Write + Seek> McapFile<W> {
    /// An empty file at time 0.
    pub(crate) fn create(target: W) -> Result<Self, RecordError> {
        Self::in_chunks_of(CHUNK_BYTES, target)
    }

    /// As [`Self::create`], with chunks of another size.
    pub(crate) fn in_chunks_of(chunk_bytes: u64, target: W) -> Result<Self, RecordError> {
        let options = WriteOptions::new().library("s2mia").chunk_size(Some(chunk_bytes));
        Ok(Self { writer: options.create(target)?, nanos: 0, messages: 0, buffer: Vec::new() })
    }

    /// A channel; its schema stands in the file.
    pub(crate) fn channel(
        &mut self,
        topic: &str,
        schema: &Schema<'_>,
    ) -> Result<Channel, RecordError> {
        let id = self.writer.add_schema(schema.name, schema.encoding, schema.data)?;
        let id = self.writer.add_channel(id, topic, schema.messages, &BTreeMap::new())?;
        Ok(Channel { id, topic: topic.to_owned(), sequence: 0 })
    }

    /// A channel of one of Foxglove's messages.
    pub(crate) fn foxglove_channel<M: Encode>(
        &mut self,
        topic: &str,
    ) -> Result<Channel, RecordError> {
        let missing =
            || RecordError::Message { topic: topic.to_owned(), why: "no schema".to_owned() };
        let schema = M::get_schema().ok_or_else(missing)?;
        let messages = M::get_message_encoding();
        let (name, encoding) = (schema.name.as_str(), schema.encoding.as_str());
        self.channel(topic, &Schema { name, encoding, data: &schema.data, messages: &messages })
    }

    /// A channel of JSON objects; `schema` is a JSON schema with a title.
    pub(crate) fn json_channel(
        &mut self,
        topic: &str,
        schema: &serde_json::Value,
    ) -> Result<Channel, RecordError> {
        let name = schema["title"].as_str().unwrap_or_default();
        let data = schema.to_string().into_bytes();
        self.channel(topic, &Schema { name, encoding: "jsonschema", data: &data, messages: "json" })
    }

    /// Words about the file.
    pub(crate) fn metadata(
        &mut self,
        name: &str,
        metadata: &BTreeMap<String, String>,
    ) -> Result<(), RecordError> {
        let record = Metadata { name: name.to_owned(), metadata: metadata.clone() };
        Ok(self.writer.write_metadata(&record)?)
    }

    /// A file within the file.
    pub(crate) fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        data: &[u8],
    ) -> Result<(), RecordError> {
        Ok(self.writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(data),
        })?)
    }

    /// Simulated time.
    pub(crate) fn now(&self) -> Timestamp {
        Timestamp::new((self.nanos / 1_000_000_000) as u32, (self.nanos % 1_000_000_000) as u32)
    }

    /// Lets simulated time pass.
    pub(crate) fn advance(&mut self, nanos: u64) {
        self.nanos += nanos;
    }

    /// Lets simulated time pass before the next episode.
    pub(crate) fn pause(&mut self) {
        self.nanos += PAUSE_NANOS;
    }

    /// One of Foxglove's messages, now.
    pub(crate) fn foxglove<M: Encode>(
        &mut self,
        channel: &mut Channel,
        message: &M,
    ) -> Result<(), RecordError> {
        let mut buffer = std::mem::take(&mut self.buffer);
        buffer.clear();
        let encoded = message.encode(&mut buffer).map_err(|error| RecordError::Message {
            topic: channel.topic.clone(),
            why: error.to_string(),
        });
        let written = encoded.and_then(|()| self.write(channel, &buffer));
        self.buffer = buffer;
        written
    }

    /// An encoded message, now.
    pub(crate) fn write(&mut self, channel: &mut Channel, data: &[u8]) -> Result<(), RecordError> {
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time: self.nanos,
            publish_time: self.nanos,
        };
        channel.sequence += 1;
        self.writer.write_to_known_channel(&header, data)?;
        self.messages += 1;
        Ok(())
    }
}

#[cfg(test)]
impl<W: Write + Seek> McapFile<W> {
    /// The target with the whole file in it.
    pub(crate) fn into_finished(mut self) -> Result<W, RecordError> {
        self.writer.finish()?;
        Ok(self.writer.into_inner())
    }
}

impl McapFile<BufWriter<File>> {
    /// Closes the file, on the disk, and gives the number of its messages.
    pub(crate) fn finish(mut self) -> Result<u64, RecordError> {
        self.writer.finish()?;
        let file = self.writer.into_inner().into_inner().map_err(IntoInnerError::into_error)?;
        file.sync_all()?;
        Ok(self.messages)
    }
}
