//! Writes shares to a log file: MCAP with embedded schemas.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;

use proto::{EnvironmentSpec, Episodes, RunDescription};
use sim::{EnvironmentBatch, LinkShape, TaskConfig};

use crate::channels::{DrivenShape, Scenery, ShareChannels};
use crate::error::RecordError;
use crate::mcap_file::{McapFile, NANOS_PER_SEC, verify};
use crate::share::LoggedShare;

/// Name of the metadata record with the run, task and actor of a log.
pub(super) const METADATA_NAME: &str = "s2mia.log";
/// Name of the metadata record at the end of a log with the numbers of written and lost shares and steps.
pub(super) const TOTALS_NAME: &str = "s2mia.log.totals";
/// Name of the attachment with the task's settings.
pub(super) const TASK_NAME: &str = "task.json";
/// Name of the attachment with the run's resolved settings.
pub(super) const SETTINGS_NAME: &str = "config.toml";

/// Origin of the shares of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Origin {
    /// Metadata: run, task, actor.
    words: BTreeMap<String, String>,
    settings_toml: String,
    task_settings: String,
    description: EnvironmentSpec,
    /// The simulated robot and what is fixed around it.
    scenery: Option<Scenery>,
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
            description: run.environment.clone(),
            scenery: sim::environments(task, 1).ok().and_then(|world| scenery(&*world)),
        }
    }

    /// Origin of episodes recorded in `world` without a learner, with the resolved settings as TOML and the task's as
    /// JSON.
    pub(crate) fn of_episodes(
        metadata: &BTreeMap<String, String>,
        (settings_toml, task_settings): (&str, &str),
        world: &dyn EnvironmentBatch,
    ) -> Self {
        let description = world.description().clone();
        let words = [
            ("task", description.task.clone()),
            ("rollout_fingerprint", rollout::rollout_fingerprint().to_string()),
            ("state_kind", description.state_kind.clone()),
            ("dt_secs", description.dt_secs.to_string()),
            ("s2mia", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        let words = words.map(|(name, value)| (name.to_owned(), value));
        Self {
            words: metadata.clone().into_iter().chain(words).collect(),
            settings_toml: settings_toml.to_owned(),
            task_settings: task_settings.to_owned(),
            scenery: scenery(world),
            description,
        }
    }
}

/// The simulated robot and what is fixed around it; `None` for games and external environments.
fn scenery(world: &dyn EnvironmentBatch) -> Option<Scenery> {
    let simulated = world.world(0)?;
    let pose = world.pose(0);
    let drivers = sim::drivers(world);
    let driven = |shape: LinkShape| {
        let link = pose.links.iter().position(|link| link.name == shape.link);
        DrivenShape { driver: link.and_then(|link| drivers[link]), shape }
    };
    let shapes = simulated.robot().shapes().into_iter();
    let shapes = shapes.chain(simulated.fixed_shapes()).map(driven).collect();
    Some(Scenery { shapes, floor: simulated.floor_height() })
}

/// A log file being written.
pub(crate) struct LogFile {
    path: PathBuf,
    file: McapFile,
    channels: ShareChannels,
    dt_nanos: u64,
    /// Episode of the last share and the step after it.
    last: Option<(String, u32)>,
    /// Written shares and steps.
    written: (u64, u64),
}

impl LogFile {
    /// Starts a file: metadata and channels.
    pub(crate) fn begin(
        (path, target): (PathBuf, File),
        origin: &Origin,
    ) -> Result<Self, RecordError> {
        let mut file = McapFile::create(target)?;
        file.metadata(METADATA_NAME, &origin.words)?;
        file.attach(SETTINGS_NAME, "application/toml", origin.settings_toml.as_bytes())?;
        file.attach(TASK_NAME, "application/json", origin.task_settings.as_bytes())?;
        let (description, scenery) = (&origin.description, origin.scenery.as_ref());
        Ok(Self {
            channels: ShareChannels::create(&mut file, description, scenery)?,
            dt_nanos: (description.dt_secs * 1e9).round() as u64,
            last: None,
            written: (0, 0),
            path,
            file,
        })
    }

    /// Writes a share. Adds a second of simulated time before it, unless it continues the previous share.
    pub(crate) fn write(&mut self, share: &LoggedShare) -> Result<(), RecordError> {
        let place = (share.head.episode_id.clone(), share.head.first_step);
        if self.last.as_ref().is_some_and(|last| *last != place) {
            self.file.advance(NANOS_PER_SEC);
        }
        self.channels.write(&mut self.file, share, self.dt_nanos)?;
        self.last = Some((place.0, share.next_step()));
        self.written = (self.written.0 + 1, self.written.1 + share.steps.len() as u64);
        Ok(())
    }

    /// Current size of the file without the open chunk, bytes.
    pub(super) fn bytes(&self) -> Result<u64, RecordError> {
        Ok(std::fs::metadata(&self.path)?.len())
    }

    /// Flushes, closes and verifies the file. `lost` has the lost shares and steps. Returns the number of messages.
    pub(crate) fn finish(mut self, lost: (u64, u64)) -> Result<u64, RecordError> {
        self.file.metadata(TOTALS_NAME, &totals(self.written, lost))?;
        let messages = self.file.finish()?;
        verify(&self.path, messages)?;
        Ok(messages)
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
