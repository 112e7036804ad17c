//! Reads the complete shares of a log in order, and a log's totals.

use std::collections::BTreeMap;
use std::io::{Read as _, Seek as _};
use std::path::Path;

use mcap::records::{Record, op};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader};
use prost::Message;
use proto::trajectory_log::{AgentStep, Share, ShareEnd, Step};
use sim::Pose;

use super::error::LogError;
use super::file::{METADATA_NAME, SETTINGS_NAME, TASK_NAME, TOTALS_NAME};
use super::{records, source};
use crate::share::{LoggedShare, LoggedStep};

/// Metadata and attachments of a log.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadShares {
    /// Run, task and actor.
    pub words: BTreeMap<String, String>,
    /// Written and lost shares and steps; `None` if the end of the file is missing.
    pub totals: Option<BTreeMap<String, String>>,
    /// The task's settings as JSON.
    pub task_settings: String,
    /// The run's resolved settings as TOML.
    pub settings_toml: String,
    /// Number of complete shares.
    pub shares: u64,
    /// Number of steps of incomplete shares.
    pub torn_steps: u64,
}

/// Reads a finished log, checks all checksums and schemas, and passes each complete share to `on_share`.
///
/// # Errors
/// If the file is damaged or not a trajectory log, or `on_share` fails.
pub fn read_shares(
    bytes: &[u8],
    mut on_share: impl FnMut(LoggedShare) -> Result<(), LogError>,
) -> Result<ReadShares, LogError> {
    let mut assembler = Assembler::default();
    let mut log = ReadShares::default();
    records::read(bytes, |record| {
        match record {
            Record::Metadata(record) if record.name == METADATA_NAME => log.words = record.metadata,
            Record::Metadata(record) if record.name == TOTALS_NAME => {
                log.totals = Some(record.metadata);
            }
            Record::Attachment { header, data, .. } => match header.name.as_str() {
                TASK_NAME => log.task_settings = text(&data)?,
                SETTINGS_NAME => log.settings_toml = text(&data)?,
                _ => {}
            },
            other => {
                if let Some(share) = assembler.take(other)? {
                    log.shares += 1;
                    on_share(share)?;
                }
            }
        }
        Ok(())
    })?;
    if log.words.is_empty() {
        return Err(LogError::Foreign("it does not name its run and task".to_owned()));
    }
    if log.task_settings.is_empty() {
        let why =
            "its environment is another program's; only the simulator's episodes can be checked";
        return Err(LogError::Unfit(why.to_owned()));
    }
    log.torn_steps = assembler.torn_steps + assembler.open_steps();
    Ok(log)
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

fn text(data: &[u8]) -> Result<String, LogError> {
    let wrong = |_| LogError::Damaged("an attachment is not UTF-8 text".to_owned());
    String::from_utf8(data.to_vec()).map_err(wrong)
}

/// Content of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Share,
    Agent(usize),
    Step,
    ShareEnd,
    Other,
}

impl Role {
    /// Content of a topic, and the schema that it must have.
    fn of(topic: &str) -> (Self, &'static str) {
        match topic {
            "/share" => (Self::Share, "s2mia.log.v1.Share"),
            "/step" => (Self::Step, "s2mia.log.v1.Step"),
            "/share_end" => (Self::ShareEnd, "s2mia.log.v1.ShareEnd"),
            _ => match topic.strip_prefix("/agents/").map(str::parse) {
                Some(Ok(agent)) => (Self::Agent(agent), "s2mia.log.v1.AgentStep"),
                _ => (Self::Other, ""),
            },
        }
    }
}

/// Assembles messages to shares. Incomplete shares are skipped and their steps counted.
#[derive(Default)]
struct Assembler {
    /// Name and encoding of each schema.
    schemas: BTreeMap<u16, (String, String)>,
    roles: BTreeMap<u16, Role>,
    agents: usize,
    open: Option<LoggedShare>,
    acted: Vec<AgentStep>,
    torn_steps: u64,
}

impl Assembler {
    /// Adds a record; returns a share if the record completes it.
    fn take(&mut self, record: Record<'_>) -> Result<Option<LoggedShare>, LogError> {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, (header.name, header.encoding));
                Ok(None)
            }
            Record::Channel(channel) => self.declare(&channel).map(|()| None),
            Record::Message { header, data } => self.message(header.channel_id, &data),
            _ => Ok(None),
        }
    }

    fn declare(&mut self, channel: &mcap::records::Channel) -> Result<(), LogError> {
        let (role, expected) = Role::of(&channel.topic);
        let (name, encoding) = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
        if role != Role::Other && (name.as_str(), encoding.as_str()) != (expected, "protobuf") {
            let topic = &channel.topic;
            return Err(LogError::Foreign(format!(
                "{topic} has the schema {name:?} instead of {expected}"
            )));
        }
        if self.roles.insert(channel.id, role).is_none() && matches!(role, Role::Agent(_)) {
            self.agents += 1;
        }
        Ok(())
    }

    fn message(&mut self, channel: u16, data: &[u8]) -> Result<Option<LoggedShare>, LogError> {
        let unknown = || LogError::Damaged("a message has an unknown channel".to_owned());
        match self.roles.get(&channel).copied().ok_or_else(unknown)? {
            Role::Share => self.begin(Share::decode(data)?),
            Role::Agent(index) if index == self.acted.len() => {
                self.acted.push(AgentStep::decode(data)?);
            }
            Role::Agent(_) | Role::Other => {}
            Role::Step => self.step(Step::decode(data)?),
            Role::ShareEnd => return Ok(self.end(ShareEnd::decode(data)?)),
        }
        Ok(None)
    }

    fn begin(&mut self, head: Share) {
        self.torn_steps += self.open_steps();
        let end = ShareEnd::default();
        self.open = Some(LoggedShare { head, steps: Vec::new(), end });
        self.acted.clear();
    }

    fn step(&mut self, step: Step) {
        let agents = std::mem::take(&mut self.acted);
        let all = agents.len() == self.agents;
        match &mut self.open {
            Some(share) if all && step.step == share.next_step() => {
                let (pose, efforts) = (Pose::default(), Vec::new());
                share.steps.push(LoggedStep { pose, efforts, agents, step });
            }
            _ => {
                self.torn_steps += 1 + self.open_steps();
                self.open = None;
            }
        }
    }

    fn end(&mut self, end: ShareEnd) -> Option<LoggedShare> {
        let share = self.open.take()?;
        if end.steps as usize != share.steps.len() {
            self.torn_steps += share.steps.len() as u64;
            return None;
        }
        Some(LoggedShare { end, ..share })
    }

    fn open_steps(&self) -> u64 {
        self.open.as_ref().map_or(0, |share| share.steps.len() as u64)
    }
}

impl ReadShares {
    /// Number of shares that the actor could not write; `None` if the end of the log, which states it, is missing.
    #[must_use]
    pub fn lost_shares(&self) -> Option<u64> {
        self.total("lost_shares")
    }

    /// Number of shares that the actor wrote and that are no longer in the log, whole; `None` as above.
    #[must_use]
    pub fn missing_shares(&self) -> Option<u64> {
        Some(self.total("shares")?.saturating_sub(self.shares))
    }

    fn total(&self, figure: &str) -> Option<u64> {
        self.totals.as_ref()?.get(figure)?.parse().ok()
    }

    /// Settings of the task.
    ///
    /// # Errors
    /// If this program does not support the settings.
    pub fn task(&self) -> Result<sim::TaskConfig, LogError> {
        serde_json::from_str(&self.task_settings)
            .map_err(|error| LogError::Unfit(format!("invalid task settings: {error}")))
    }
}

impl From<prost::DecodeError> for LogError {
    fn from(error: prost::DecodeError) -> Self {
        Self::Damaged(format!("a message does not match its schema: {error}"))
    }
}
