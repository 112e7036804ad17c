//! Writer of an MCAP file, with a simulated clock that starts at 0, and the check of a finished file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, IntoInnerError};
use std::path::Path;

use foxglove::Encode;
use foxglove::messages::Timestamp;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};

use crate::error::RecordError;

/// Size of a chunk before compression, bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// Nanoseconds in a second.
pub(crate) const NANOS_PER_SEC: u64 = 1_000_000_000;

/// A channel of a file.
#[derive(Clone, Debug)]
pub(crate) struct Channel {
    id: u16,
    sequence: u32,
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

/// An MCAP file being written. Chunks are compressed and have checksums.
pub(crate) struct McapFile {
    writer: Writer<BufWriter<File>>,
    nanos: u64,
    messages: u64,
}

impl McapFile {
    /// Starts an empty file at time 0.
    pub(crate) fn create(target: File) -> Result<Self, RecordError> {
        Self::in_chunks_of(CHUNK_BYTES, target)
    }

    /// As [`Self::create`], with a different chunk size.
    pub(crate) fn in_chunks_of(chunk_bytes: u64, target: File) -> Result<Self, RecordError> {
        let options = WriteOptions::new().library("s2mia").chunk_size(Some(chunk_bytes));
        Ok(Self { writer: options.create(BufWriter::new(target))?, nanos: 0, messages: 0 })
    }

    /// Writes a metadata record.
    pub(crate) fn metadata(
        &mut self,
        name: &str,
        metadata: &BTreeMap<String, String>,
    ) -> Result<(), RecordError> {
        let record = Metadata { name: name.to_owned(), metadata: metadata.clone() };
        Ok(self.writer.write_metadata(&record)?)
    }

    /// Writes an attachment.
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

    /// Creates a channel with a schema and metadata.
    pub(crate) fn channel(
        &mut self,
        topic: &str,
        schema: &Schema<'_>,
        about: &BTreeMap<String, String>,
    ) -> Result<Channel, RecordError> {
        let id = self.writer.add_schema(schema.name, schema.encoding, schema.data)?;
        let id = self.writer.add_channel(id, topic, schema.messages, about)?;
        Ok(Channel { id, sequence: 0 })
    }

    /// Writes an encoded message with the current time.
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

    /// Advances simulated time.
    pub(crate) fn advance(&mut self, nanos: u64) {
        self.nanos += nanos;
    }

    /// Creates a channel for a Foxglove message type.
    pub(crate) fn foxglove_channel<M: Encode>(
        &mut self,
        topic: &str,
    ) -> Result<Channel, RecordError> {
        let schema = M::get_schema().expect("every Foxglove message has a schema");
        let messages = M::get_message_encoding();
        let (name, encoding) = (schema.name.as_str(), schema.encoding.as_str());
        let schema = Schema { name, encoding, data: &schema.data, messages: &messages };
        self.channel(topic, &schema, &BTreeMap::new())
    }

    /// Current time of messages as a Foxglove timestamp.
    pub(crate) fn now(&self) -> Timestamp {
        let nanos = self.nanos;
        Timestamp::new((nanos / NANOS_PER_SEC) as u32, (nanos % NANOS_PER_SEC) as u32)
    }

    /// Flushes and closes the file; returns the number of its messages.
    pub(crate) fn finish(mut self) -> Result<u64, RecordError> {
        self.writer.finish()?;
        let file = self.writer.into_inner().into_inner().map_err(IntoInnerError::into_error)?;
        file.sync_all()?;
        Ok(self.messages)
    }
}

/// Reads the whole file, checks its checksums and counts its messages.
pub(crate) fn verify(path: &Path, written: u64) -> Result<(), RecordError> {
    let bytes = std::fs::read(path)?;
    let mut found = 0;
    let options = mcap::read::Options::ValidateChunkCrcs.into();
    for message in mcap::MessageStream::new_with_options(&bytes, options)? {
        message?;
        found += 1;
    }
    if found == written { Ok(()) } else { Err(RecordError::Verification { written, found }) }
}
