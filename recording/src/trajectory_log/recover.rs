//! Recovers the intact records of a damaged or unfinished MCAP file of any content.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Record, op};
use mcap::{Attachment, WriteOptions, Writer};

use super::error::LogError;
use super::records;
use super::source::Draft;
use crate::error::RecordError;
use records::{RECORD_HEAD, number};

/// Highest opcode of the format; opcodes from [`PRIVATE`] on are application-specific.
const HIGHEST: u8 = op::DATA_END;
const PRIVATE: u8 = 0x80;

/// Data that is missing in the new file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Loss {
    /// Bytes of the old file that are not valid records, or have wrong checksums.
    Bytes {
        /// Offset of the first byte.
        offset: usize,
        /// Number of bytes.
        length: usize,
    },
    /// Messages on channels whose descriptions are lost.
    Messages(u64),
    /// The end is missing; the amount of lost data is unknown.
    End,
    /// The checksum of the file is wrong, although the checksums of all its parts are correct.
    Unlocated,
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bytes { offset, length } => write!(f, "{length} bytes at offset {offset}"),
            Self::Messages(count) => write!(f, "{count} messages on unknown channels"),
            Self::End => f.write_str("all data after the end of the file"),
            Self::Unlocated => f.write_str("changed bytes outside all chunks"),
        }
    }
}

/// Result of a recovery.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Number of messages in the new file.
    pub messages: u64,
    /// Lost data; empty if nothing was lost.
    pub losses: Vec<Loss>,
}

/// Copies every intact record from `bytes` to the new file `out`, which appears atomically.
///
/// # Errors
/// If `bytes` is not an MCAP file, or `out` exists or cannot be written.
pub fn recover(bytes: &[u8], out: &Path) -> Result<Recovered, LogError> {
    if !bytes.starts_with(mcap::MAGIC) {
        return Err(LogError::NotMcap);
    }
    let (draft, (_, target)) = Draft::begin(out)?;
    let (recovered, target) = copy(bytes, BufWriter::new(target))?;
    let file = target.into_inner().map_err(|error| RecordError::File(error.into_error()))?;
    file.sync_all().map_err(RecordError::File)?;
    draft.publish()?;
    Ok(recovered)
}

/// As [`recover`], to any target.
pub(super) fn copy<W: Write + Seek>(bytes: &[u8], target: W) -> Result<(Recovered, W), LogError> {
    let options = WriteOptions::new().library("s2mia");
    let writer = options.create(target).map_err(RecordError::Format)?;
    let mut copy = Copy { writer, schemas: BTreeMap::new(), channels: summary_channels(bytes) };
    let mut recovered = copy.all(bytes)?;
    if recovered.losses.is_empty() && is_contradicted(bytes) {
        recovered.losses.push(Loss::Unlocated);
    }
    copy.writer.finish().map_err(RecordError::Format)?;
    Ok((recovered, copy.writer.into_inner()))
}

/// Whether the checksum of the data section is wrong.
fn is_contradicted(bytes: &[u8]) -> bool {
    let mut ended = false;
    // Damage after the data section loses nothing, because indexes are rewritten.
    let read = records::read_data(bytes, |record| {
        ended |= matches!(record, Record::DataEnd(_));
        Ok(())
    });
    read.is_err() && !ended
}

/// Channel descriptions at the end of the file, for chunks whose descriptions are lost.
fn summary_channels(bytes: &[u8]) -> BTreeMap<u16, Described> {
    let Ok(Some(summary)) = mcap::Summary::read(bytes) else { return BTreeMap::new() };
    let described = |channel: &std::sync::Arc<mcap::Channel<'_>>| Described {
        topic: channel.topic.clone(),
        encoding: channel.message_encoding.clone(),
        metadata: channel.metadata.clone(),
        schema: channel.schema.as_ref().map(|schema| Schema {
            name: schema.name.clone(),
            encoding: schema.encoding.clone(),
            data: schema.data.to_vec(),
        }),
        id: None,
    };
    summary.channels.iter().map(|(id, channel)| (*id, described(channel))).collect()
}

#[derive(Clone, Debug)]
struct Schema {
    name: String,
    encoding: String,
    data: Vec<u8>,
}

/// A channel of the old file.
#[derive(Clone, Debug)]
struct Described {
    topic: String,
    encoding: String,
    metadata: BTreeMap<String, String>,
    schema: Option<Schema>,
    /// Id in the new file.
    id: Option<u16>,
}

/// The new file being written.
struct Copy<W: Write + Seek> {
    writer: Writer<W>,
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Described>,
}

impl<W: Write + Seek> Copy<W> {
    fn all(&mut self, bytes: &[u8]) -> Result<Recovered, LogError> {
        let mut recovered = Recovered::default();
        let mut unknown = 0;
        let mut at = mcap::MAGIC.len();
        loop {
            let end = match next(bytes, at) {
                Next::DataEnd => break,
                Next::Eof => {
                    recovered.losses.push(Loss::End);
                    break;
                }
                Next::Record(opcode, body) => {
                    let (messages, unknowns) = (&mut recovered.messages, &mut unknown);
                    if self.record(opcode, body, messages, unknowns)? {
                        at += RECORD_HEAD + body.len();
                        continue;
                    }
                    at + RECORD_HEAD + body.len()
                }
                Next::Broken => resume(bytes, at + 1),
            };
            recovered.losses.push(Loss::Bytes { offset: at, length: end - at });
            at = end;
        }
        if unknown > 0 {
            recovered.losses.push(Loss::Messages(unknown));
        }
        Ok(recovered)
    }

    /// Copies a record; returns false if it is damaged.
    fn record(
        &mut self,
        opcode: u8,
        body: &[u8],
        messages: &mut u64,
        unknown: &mut u64,
    ) -> Result<bool, LogError> {
        let mut each = |copy: &mut Self, record: Record<'_>| {
            match copy.copy(record)? {
                Copied::Message => *messages += 1,
                Copied::Unknown => *unknown += 1,
                Copied::Other => {}
            }
            Ok(())
        };
        if opcode != op::CHUNK {
            return match records::parse(opcode, body) {
                Ok(record) => each(self, record).map(|()| true),
                Err(_) => Ok(false),
            };
        }
        // The whole chunk is checked before any of its records are copied.
        if records::unpack(body, &mut |_| Ok(())).is_err() {
            return Ok(false);
        }
        records::unpack(body, &mut |record| each(self, record)).map(|()| true)
    }

    fn copy(&mut self, record: Record<'_>) -> Result<Copied, LogError> {
        match record {
            Record::Schema { header, data } => {
                let schema =
                    Schema { name: header.name, encoding: header.encoding, data: data.to_vec() };
                self.schemas.insert(header.id, schema);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned();
                let known = self.channels.get(&channel.id).and_then(|known| known.id);
                let mcap::records::Channel { topic, message_encoding: encoding, metadata, .. } =
                    channel;
                let described = Described { topic, encoding, metadata, schema, id: known };
                self.channels.insert(channel.id, described);
            }
            Record::Message { header, data } => return self.message(header, &data),
            Record::Metadata(metadata) => {
                self.writer.write_metadata(&metadata).map_err(RecordError::Format)?;
            }
            Record::Attachment { header, data, .. } => {
                let attachment = Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                };
                self.writer.attach(&attachment).map_err(RecordError::Format)?;
            }
            _ => {}
        }
        Ok(Copied::Other)
    }

    fn message(&mut self, mut header: MessageHeader, data: &[u8]) -> Result<Copied, LogError> {
        let Some(channel) = self.channels.get_mut(&header.channel_id) else {
            return Ok(Copied::Unknown);
        };
        header.channel_id = match channel.id {
            Some(id) => id,
            None => *channel.id.insert(declare(&mut self.writer, channel)?),
        };
        self.writer.write_to_known_channel(&header, data).map_err(RecordError::Format)?;
        Ok(Copied::Message)
    }
}

/// Result of copying a record.
enum Copied {
    Message,
    /// A message on an unknown channel.
    Unknown,
    Other,
}

/// Adds a channel to the new file.
fn declare(
    writer: &mut Writer<impl Write + Seek>,
    channel: &Described,
) -> Result<u16, RecordError> {
    let schema = match &channel.schema {
        Some(schema) => writer.add_schema(&schema.name, &schema.encoding, &schema.data)?,
        // The format's id for no schema.
        None => 0,
    };
    Ok(writer.add_channel(schema, &channel.topic, &channel.encoding, &channel.metadata)?)
}

/// Data at a record boundary.
enum Next<'a> {
    Record(u8, &'a [u8]),
    /// End of the data section; only indexes follow.
    DataEnd,
    /// End of the file.
    Eof,
    /// Not a valid record.
    Broken,
}

fn next(bytes: &[u8], at: usize) -> Next<'_> {
    let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) else { return Next::Eof };
    if rest.len() < RECORD_HEAD {
        return Next::Broken;
    }
    let (opcode, length) = (rest[0], number(rest, 1));
    let known = (1..=HIGHEST).contains(&opcode) || opcode >= PRIVATE;
    if !known || length > (rest.len() - RECORD_HEAD) as u64 {
        return Next::Broken;
    }
    match opcode {
        op::DATA_END if length == 4 => Next::DataEnd,
        op::DATA_END | op::FOOTER => Next::Broken,
        _ => Next::Record(opcode, &rest[RECORD_HEAD..][..length as usize]),
    }
}

/// First offset from `from` on at which a chunk starts, or the end of the file.
fn resume(bytes: &[u8], from: usize) -> usize {
    let begins = |at: &usize| match next(bytes, *at) {
        Next::Record(op::CHUNK, body) => records::is_chunk(body),
        _ => false,
    };
    (from..bytes.len()).find(begins).unwrap_or(bytes.len())
}
