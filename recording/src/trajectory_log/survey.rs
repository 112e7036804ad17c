//! Summary of an MCAP file, by topic.

use std::collections::BTreeMap;
use std::io::{Read as _, Seek as _};
use std::path::Path;

use mcap::records::{Record, op};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader};

use super::error::LogError;
use super::names::{METADATA_NAME, TOTALS_NAME};
use super::{records, source};

/// Summary of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Metadata with the origin, if it is a trajectory log.
    pub words: BTreeMap<String, String>,
    /// Metadata at the end, with written and lost shares and steps.
    pub totals: BTreeMap<String, String>,
    /// Topics by name.
    pub topics: BTreeMap<String, Topic>,
    /// Simulated time from the first to the last message, seconds.
    pub secs: f64,
}

/// Summary of a topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topic {
    /// Name of the message type.
    pub schema: String,
    /// Number of messages.
    pub messages: u64,
}

/// Reads a finished MCAP file of any content and checks all checksums.
///
/// # Errors
/// If the file is unfinished or damaged.
pub fn survey(bytes: &[u8]) -> Result<Survey, LogError> {
    let mut survey = Survey::default();
    let (mut schemas, mut channels) = (BTreeMap::new(), BTreeMap::new());
    let mut span: Option<(u64, u64)> = None;
    records::read(bytes, |record| {
        match record {
            Record::Metadata(record) if record.name == METADATA_NAME => {
                survey.words = record.metadata
            }
            Record::Metadata(record) if record.name == TOTALS_NAME => {
                survey.totals = record.metadata
            }
            Record::Schema { header, .. } => {
                schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                survey.topics.entry(channel.topic.clone()).or_default().schema = schema;
                channels.insert(channel.id, channel.topic);
            }
            Record::Message { header, .. } => {
                let topic = channels.get(&header.channel_id).cloned().unwrap_or_default();
                survey.topics.entry(topic).or_default().messages += 1;
                let (first, last) = span.unwrap_or((header.log_time, header.log_time));
                span = Some((first.min(header.log_time), last.max(header.log_time)));
            }
            _ => {}
        }
        Ok(())
    })?;
    survey.secs = span.map_or(0.0, |(first, last)| (last - first) as f64 / 1e9);
    Ok(survey)
}

/// Reads the totals of a finished log, without reading the whole file: `shares`, `steps`, `lost_shares` and
/// `lost_steps`.
///
/// # Errors
/// If the file cannot be read or has no totals.
pub fn totals(path: &Path) -> Result<BTreeMap<String, String>, LogError> {
    let mut file = source::open(path)?;
    let mut reader = SummaryReader::new();
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted)).map_err(LogError::Read)?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => {
                reader.notify_seeked(file.seek(to).map_err(LogError::Read)?);
            }
        }
    }
    let summary = reader.finish().ok_or(LogError::Unfinished)?;
    let last = summary.metadata_indexes.iter().find(|index| index.name == TOTALS_NAME);
    let last = last.ok_or_else(|| LogError::Foreign("it has no totals".to_owned()))?;
    let record = source::read_part(path, last.offset, last.length)?;
    match records::parse(op::METADATA, record.get(records::RECORD_HEAD..).unwrap_or_default())? {
        Record::Metadata(record) => Ok(record.metadata),
        _ => Err(LogError::Damaged("the metadata index points to another record".to_owned())),
    }
}
