//! Records evaluation episodes as MCAP files. A recording is a trajectory log ([`crate::trajectory_log`]) that is
//! written without a learner.

pub(crate) mod robot;
mod scene;
pub(crate) mod share_channels;
pub(crate) mod sink;
pub(crate) mod step_reader;
pub(crate) mod writer;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use policy::PolicySnapshot;
use proto::{ActionChoice, WeightsName};
use sim::{EnvironmentBatch, SimError};
use thiserror::Error;

use crate::evaluation::{Episode, EvaluationEpisode, play_on};
use crate::trajectory_log::{EvaluationCollector, LogFile, Origin};

/// Why an episode cannot be recorded or shown.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The file cannot be written or read.
    #[error("cannot write the file: {0}")]
    File(#[from] std::io::Error),
    /// The MCAP library returned an error.
    #[error("MCAP: {0}")]
    Format(#[from] mcap::McapError),
    /// The environment cannot be built or stepped.
    #[error(transparent)]
    Episode(#[from] SimError),
    /// A message cannot be encoded.
    #[error("cannot encode a message on {topic}: {why}")]
    Message {
        /// Topic of the message.
        topic: String,
        /// The reason.
        why: String,
    },
    /// The written file contains a different number of messages.
    #[error("the file contains {found} messages, but {written} were written")]
    Verification {
        /// Messages written.
        written: u64,
        /// Messages read.
        found: u64,
    },
}

/// The run whose episodes are recorded.
#[derive(Clone, Debug)]
pub struct RecordedRun<'a> {
    /// The policies of all agents.
    pub policy: &'a PolicySnapshot,
    /// Name of their weights.
    pub weights: WeightsName,
    /// Metadata of the file: run, task, hash of the settings.
    pub metadata: BTreeMap<String, String>,
    /// The resolved settings as TOML.
    pub settings_toml: String,
    /// Settings of the simulated task as JSON; empty with an external environment.
    pub task_settings: String,
}

/// Content of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordSummary {
    /// Results of the episodes, in order.
    pub episodes: Vec<Episode>,
    /// Number of messages.
    pub messages: u64,
    /// Size of the file, bytes.
    pub bytes: u64,
}

/// Plays `episodes` with mean actions in the only environment of `world` and writes them to `path`. The file is flushed
/// to disk, closed and verified. `on_step` gets the position in `episodes` and the number of steps after each step.
///
/// # Errors
/// If an episode fails, or the file cannot be written or verified.
pub fn record(
    world: &mut dyn EnvironmentBatch,
    run: &RecordedRun<'_>,
    episodes: &[EvaluationEpisode],
    path: &Path,
    mut on_step: impl FnMut(usize, u32),
) -> Result<RecordSummary, RecordError> {
    let origin = Origin::of_recording(run, world);
    let mut file = LogFile::begin((path.to_path_buf(), File::create(path)?), &origin)?;
    let mut summary = RecordSummary::default();
    for (index, episode) in episodes.iter().enumerate() {
        world.reset(0, 0, world.description().episode_steps, episode.key().0)?;
        let mut collector = EvaluationCollector::new(*episode, (run.weights, 0), world)?;
        let acting = (run.policy, ActionChoice::Mean);
        let played = play_on(world, acting, &mut |step| {
            collector.collect(step);
            on_step(index, step.step);
        })?;
        file.write(&collector.finish())?;
        summary.episodes.push(played);
    }
    summary.messages = file.finish((0, 0))?;
    summary.bytes = std::fs::metadata(path)?.len();
    Ok(summary)
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
