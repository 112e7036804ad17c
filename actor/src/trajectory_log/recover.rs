//! Saving what is whole in a damaged or unfinished MCAP file, whatever it holds.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Record, op};
use mcap::{Attachment, WriteOptions, Writer};

use super::source::Draft;
use super::{LogError, records};
use crate::recording::RecordError;
use records::{RECORD_HEAD, number};

/// Highest opcode that the format knows; those from [`PRIVATE`] on are for everyone's own use.
const HIGHEST: u8 = op::DATA_END;
const PRIVATE: u8 = 0x80;

/// Something that is not in the new file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Loss {
    /// These bytes of the old one are no records, or none that fit their checksum.
    Bytes {
        /// The first of them.
        offset: usize,
        /// How many there are.
        length: usize,
    },
    /// Messages on a channel whose description is lost.
    Messages(u64),
    /// The end is missing; how much was to come is not known.
    End,
    /// The file's own checksum does not fit, though every part that has one of its own is whole.
    Unlocated,
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bytes { offset, length } => write!(f, "{length} bytes from offset {offset} on"),
            Self::Messages(count) => write!(f, "{count} messages whose channel is not described"),
            Self::End => f.write_str("whatever came after the end of the file"),
            Self::Unlocated => {
                f.write_str("bytes outside of all chunks are not as they were written")
            }
        }
    }
}

/// What became of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Messages in the new file.
    pub messages: u64,
    /// What is not; empty if nothing was lost.
    pub losses: Vec<Loss>,
}

/// Copies every record that is whole from `bytes` into the new file `out`, which appears whole or not at all.
///
/// # Errors
/// If `bytes` do not begin as an MCAP file, or `out` is there already or cannot be written.
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

/// As [`recover`], into any target.
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

/// The data's own checksum does not fit.
fn is_contradicted(bytes: &[u8]) -> bool {
    let mut ended = false;
    // What is wrong behind the data's end costs nothing: indexes are written anew.
    let read = records::read_data(bytes, |record| {
        ended |= matches!(record, Record::DataEnd(_));
        Ok(())
    });
    read.is_err() && !ended
}

/// Descriptions at the file's end, for chunks whose own are lost.
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
    /// In the new file.
    id: Option<u16>,
}

/// The new file in the making.
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
                    let (messages, strangers) = (&mut recovered.messages, &mut unknown);
                    if self.record(opcode, body, messages, strangers)? {
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

    /// Copies a record; false if it is not whole.
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
                Copied::Stranger => *unknown += 1,
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
        // The whole chunk is read before anything of it is copied.
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
            return Ok(Copied::Stranger);
        };
        header.channel_id = match channel.id {
            Some(id) => id,
            None => *channel.id.insert(declare(&mut self.writer, channel)?),
        };
        self.writer.write_to_known_channel(&header, data).map_err(RecordError::Format)?;
        Ok(Copied::Message)
    }
}

/// What became of a record.
enum Copied {
    Message,
    /// A message on a channel that nothing describes.
    Stranger,
    Other,
}

/// The channel in the new file.
fn declare(
    writer: &mut Writer<impl Write + Seek>,
    channel: &Described,
) -> Result<u16, RecordError> {
    let schema = match &channel.schema {
        Some(schema) => writer.add_schema(&schema.name, &schema.encoding, &schema.data)?,
        // The format's number for none.
        None => 0,
    };
    Ok(writer.add_channel(schema, &channel.topic, &channel.encoding, &channel.metadata)?)
}

/// What stands at a place between records.
enum Next<'a> {
    Record(u8, &'a [u8]),
    /// The messages' end; behind it are indexes only.
    DataEnd,
    /// Nothing.
    Eof,
    /// No record.
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

/// The first place from `from` on where a chunk begins, or the end.
fn resume(bytes: &[u8], from: usize) -> usize {
    let begins = |at: &usize| match next(bytes, *at) {
        Next::Record(op::CHUNK, body) => records::is_chunk(body),
        _ => false,
    };
    (from..bytes.len()).find(begins).unwrap_or(bytes.len())
}
