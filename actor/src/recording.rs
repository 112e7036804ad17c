//! Episodes as MCAP files that Foxglove shows without set-up and any MCAP reader opens.
//!
//! Topics: `/tf` (every link's frame), `/scene` (the links' real shapes and the floor, once per
//! episode), `/joint_states`, and as JSON `/agents/I/action` and `/episode`. A game has no links, nor has an environment of another program: they are shown as
//! JSON on `/state`, the global state feature by feature. Times count from 0 in
//! simulated time; episodes follow one another with a second between them.

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

/// Name of the metadata record that tells which run and policy the file shows.
pub const METADATA_NAME: &str = "s2mia.run";

/// Why there is no recording.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The file cannot be written or read back.
    #[error("cannot write the file: {0}")]
    File(#[from] std::io::Error),
    /// The MCAP format got in the way.
    #[error("MCAP: {0}")]
    Format(#[from] mcap::McapError),
    /// The task cannot be built, or the episode broke off.
    #[error(transparent)]
    Episode(#[from] SimError),
    /// A message cannot be encoded.
    #[error("message on {topic}: {why}")]
    Message {
        /// Its topic.
        topic: String,
        /// What is wrong.
        why: String,
    },
    /// Reading the file back found another number of messages.
    #[error("the file holds {found} messages, {written} were written")]
    Verification {
        /// Messages written.
        written: u64,
        /// Messages read back.
        found: u64,
    },
}

/// What a recording holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordSummary {
    /// The episodes, in their order.
    pub episodes: Vec<Episode>,
    /// Messages in the file.
    pub messages: u64,
    /// Bytes of the file.
    pub bytes: u64,
}

/// Plays `episodes` episodes with mean actions in the one environment of `world`, built from `task` if the simulator did,
/// the first states drawn with `seed`, and writes them to `path`. The file is flushed to the disk, closed, read back and counted.
///
/// # Errors
/// If an episode breaks off, or the file cannot be written or read back whole.
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

/// Shows an episode with mean actions, from where environment 0 of `world` stands to its end, or until `go_on`, which
/// is asked after each step, breaks it off.
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

/// Reads the whole file back, checksums included.
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
