//! Writes shares to a log file: MCAP with embedded schemas.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use prost::Message;
use proto::trajectory_log::DESCRIPTORS;
use proto::{Episodes, RunDescription};
use sim::TaskConfig;

use super::shares::{LoggedShare, LoggedStep, ReadShares};
use super::{LogError, METADATA_NAME, SETTINGS_NAME, TASK_NAME, TOTALS_NAME};
use crate::recording::robot::RobotChannels;
use crate::recording::sink::{Channel, Schema, Sink as _};
use crate::recording::writer::McapFile;
use crate::recording::{RecordError, verify};

/// Origin of the shares of a file.
#[derive(Clone, Debug)]
pub(super) struct Origin {
    /// Metadata: run, task, actor.
    words: BTreeMap<String, String>,
    settings_toml: String,
    task_settings: String,
    task: TaskConfig,
    agents: usize,
    dt_secs: f64,
}

impl Origin {
    /// Origin of the shares of an actor in a run.
    pub(super) fn of_run(
        run: &RunDescription,
        task: &TaskConfig,
        actor: &str,
        episodes: Episodes,
    ) -> Self {
        let words = [
            ("run_id", run.run_id.clone()),
            ("task", run.environment.task.clone()),
            ("seed", run.seed.to_string()),
            ("config_sha256", run.config_sha256.to_string()),
            ("rollout_fingerprint", run.rollout_fingerprint.to_string()),
            ("state_kind", run.environment.state_kind.clone()),
            ("dt_secs", run.environment.dt_secs.to_string()),
            ("actor", actor.to_owned()),
            ("episodes", episodes.to_string()),
            ("s2mia", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        Self {
            words: words.map(|(name, value)| (name.to_owned(), value)).into(),
            settings_toml: run.settings_toml.clone(),
            task_settings: run.task_settings.clone(),
            task: task.clone(),
            agents: run.environment.agents.len(),
            dt_secs: run.environment.dt_secs,
        }
    }

    /// Origin from the metadata of a log.
    pub(super) fn of_log(log: &ReadShares) -> Result<Self, LogError> {
        let task = log.task()?;
        let world = sim::environments(&task, 1).map_err(|e| LogError::Unfit(e.to_string()))?;
        Ok(Self {
            words: log.words.clone(),
            settings_toml: log.settings_toml.clone(),
            task_settings: log.task_settings.clone(),
            agents: world.description().agents.len(),
            dt_secs: world.description().dt_secs,
            task,
        })
    }

    /// Adds a metadata entry.
    pub(super) fn with(mut self, name: &str, value: String) -> Self {
        self.words.insert(name.to_owned(), value);
        self
    }
}

/// A log file being written.
pub(super) struct LogFile {
    path: PathBuf,
    task: String,
    file: McapFile<BufWriter<File>>,
    /// `None` for a game, which has no links.
    robot: Option<RobotChannels>,
    share: Channel,
    agents: Vec<Channel>,
    step: Channel,
    share_end: Channel,
    dt_nanos: u64,
    /// Episode of the last share and the step after it.
    last: Option<(String, u32)>,
    /// Written shares and steps.
    written: (u64, u64),
}

impl LogFile {
    /// Starts a file: metadata and channels.
    pub(super) fn begin(
        (path, target): (PathBuf, File),
        origin: &Origin,
    ) -> Result<Self, RecordError> {
        let mut file = McapFile::create(BufWriter::new(target))?;
        file.metadata(METADATA_NAME, &origin.words)?;
        file.attach(SETTINGS_NAME, "application/toml", origin.settings_toml.as_bytes())?;
        file.attach(TASK_NAME, "application/json", origin.task_settings.as_bytes())?;
        let shows_links = !sim::shapes(&origin.task.task)?.is_empty();
        let agents = (0..origin.agents).map(|index| format!("/agents/{index}"));
        let agents = agents.map(|topic| own(&mut file, &topic, "AgentStep"));
        Ok(Self {
            agents: agents.collect::<Result<_, _>>()?,
            robot: shows_links.then(|| RobotChannels::create(&mut file)).transpose()?,
            share: own(&mut file, "/share", "Share")?,
            step: own(&mut file, "/step", "Step")?,
            share_end: own(&mut file, "/share_end", "ShareEnd")?,
            dt_nanos: (origin.dt_secs * 1e9).round() as u64,
            task: origin.task.task.clone(),
            last: None,
            written: (0, 0),
            path,
            file,
        })
    }

    /// Writes a share. Adds a second of simulated time before it, unless it continues the previous share.
    pub(super) fn write(&mut self, share: &LoggedShare) -> Result<(), RecordError> {
        let place = (share.head.episode_id.clone(), share.head.first_step);
        if self.last.as_ref().is_some_and(|last| *last != place) {
            self.file.pause();
        }
        self.file.write(&mut self.share, &share.head.encode_to_vec())?;
        if let Some(robot) = &mut self.robot {
            robot.scene(&mut self.file, &self.task)?;
        }
        share.steps.iter().try_for_each(|step| self.write_step(step))?;
        self.file.write(&mut self.share_end, &share.end.encode_to_vec())?;
        self.last = Some((place.0, share.next_step()));
        self.written = (self.written.0 + 1, self.written.1 + share.steps.len() as u64);
        Ok(())
    }

    fn write_step(&mut self, step: &LoggedStep) -> Result<(), RecordError> {
        if let Some(robot) = &mut self.robot {
            robot.pose(&mut self.file, &step.pose)?;
        }
        for (channel, agent) in self.agents.iter_mut().zip(&step.agents) {
            self.file.write(channel, &agent.encode_to_vec())?;
        }
        self.file.write(&mut self.step, &step.step.encode_to_vec())?;
        self.file.advance(self.dt_nanos);
        Ok(())
    }

    /// Current size of the file without the open chunk, bytes.
    pub(super) fn bytes(&self) -> Result<u64, RecordError> {
        Ok(std::fs::metadata(&self.path)?.len())
    }

    /// Flushes, closes and verifies the file. `lost` has the lost shares and steps.
    pub(super) fn finish(mut self, lost: (u64, u64)) -> Result<(), RecordError> {
        self.file.metadata(TOTALS_NAME, &totals(self.written, lost))?;
        let messages = self.file.finish()?;
        verify(&self.path, messages)
    }
}

/// Metadata at the end of a log.
fn totals(written: (u64, u64), lost: (u64, u64)) -> BTreeMap<String, String> {
    let figures = [
        ("shares", written.0),
        ("steps", written.1),
        ("lost_shares", lost.0),
        ("lost_steps", lost.1),
    ];
    figures.map(|(name, value)| (name.to_owned(), value.to_string())).into()
}

/// Creates a channel for a message of this project.
fn own(
    file: &mut McapFile<BufWriter<File>>,
    topic: &str,
    message: &str,
) -> Result<Channel, RecordError> {
    let name = format!("s2mia.log.v1.{message}");
    let (encoding, messages) = ("protobuf", "protobuf");
    file.channel(topic, &Schema { name: &name, encoding, data: DESCRIPTORS, messages })
}
