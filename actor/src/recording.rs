//! Records episodes as MCAP files with embedded schemas, for Foxglove and other MCAP readers.
//!
//! Topics: `/tf` (frames of the links), `/scene` (shapes of the links and the floor, once per episode),
//! `/joint_states`, and as JSON `/agents/I/action` and `/episode`. Games and external environments have no links;
//! instead, their global state is JSON on `/state`. Timestamps are simulated time from 0, with a second between
//! episodes.

pub(crate) mod channels;
pub(crate) mod robot;
mod scene;
pub(crate) mod sink;
pub(crate) mod writer;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::ops::ControlFlow;
use std::path::Path;

use policy::{Draw, Key, PolicySnapshot, Purpose, RunSeed};
use proto::ActionChoice;
use sim::{EnvironmentBatch, SimError, TaskConfig};
use thiserror::Error;

use crate::evaluation::{Episode, PlayedStep, play_while};
use crate::recording::channels::Channels;
use crate::recording::sink::Sink;
use crate::recording::writer::McapFile;

/// Name of the metadata record with the run and the policy of the file.
pub const METADATA_NAME: &str = "s2mia.run";

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

/// Plays `episodes` episodes with mean actions in the only environment of `world`, from starts drawn with `seed`, and
/// writes them to `path`. `task` has the settings of a simulated environment. The file is flushed to disk, closed and
/// verified.
///
/// # Errors
/// If an episode fails, or the file cannot be written or verified.
pub fn record(
    (world, task): (&mut dyn EnvironmentBatch, Option<&TaskConfig>),
    policy: &PolicySnapshot,
    seed: RunSeed,
    episodes: u32,
    path: &Path,
    metadata: &BTreeMap<String, String>,
) -> Result<RecordSummary, RecordError> {
    let file = McapFile::create(BufWriter::new(File::create(path)?))?;
    let mut channels = Channels::create(file, world)?;
    channels.describe(task, metadata)?;
    let mut summary = RecordSummary::default();
    for episode in 0..episodes {
        let key = Key::of(seed, Draw::of(Purpose::Recording).environment(episode));
        world.reset(0, 0, world.description().episode_steps, key.0)?;
        let whole = || ControlFlow::Continue(());
        summary.episodes.push(show_episode((&mut *world, policy), episode, &mut channels, whole)?);
    }
    summary.messages = channels.finish()?;
    summary.bytes = std::fs::metadata(path)?.len();
    verify(path, summary.messages)?;
    Ok(summary)
}

/// Writes an episode with mean actions to `channels`, from the current state of environment 0 of `world` to its end, or
/// until `go_on`, which is called after each step, stops it.
pub(crate) fn show_episode<S: Sink>(
    (world, policy): (&mut dyn EnvironmentBatch, &PolicySnapshot),
    index: u32,
    channels: &mut Channels<S>,
    mut go_on: impl FnMut() -> ControlFlow<()>,
) -> Result<Episode, RecordError> {
    channels.begin(world)?;
    let mut shown = Ok(());
    let mut total = 0.0;
    let episode = play_while(world, (policy, ActionChoice::Mean), &mut |step: &PlayedStep<'_>| {
        total += f64::from(step.outcome.reward);
        shown = channels.step(step, index, total);
        if shown.is_err() { ControlFlow::Break(()) } else { go_on() }
    })?;
    shown?;
    channels.pause();
    Ok(episode)
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
