//! What an MCAP file holds, topic by topic.

use std::collections::BTreeMap;

use mcap::records::Record;

use super::{LogError, METADATA_NAME, TOTALS_NAME, records};

/// A file at a glance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// What it says of its origin, if it is a trajectory log.
    pub words: BTreeMap<String, String>,
    /// What it says of itself at its end.
    pub totals: BTreeMap<String, String>,
    /// By name.
    pub topics: BTreeMap<String, Topic>,
    /// From the first message to the last, simulated.
    pub secs: f64,
}

/// A topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topic {
    /// Name of its messages' type.
    pub schema: String,
    /// Number of messages.
    pub messages: u64,
}

/// Reads a finished MCAP file through, whatever is in it, and checks every checksum.
///
/// # Errors
/// If it is not finished or damaged.
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
