//! Records evaluation episodes as MCAP files. A recording is a trajectory log ([`crate::trajectory_log`]) that is
//! written without a learner.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use policy::PolicySnapshot;
use proto::{ActionChoice, WeightsName};
use rollout::{Episode, EvaluationEpisode, StepEvent, play_episode};
use sim::EnvironmentBatch;

use crate::error::RecordError;
use crate::trajectory_log::{LogFile, Origin, ShareCollector};

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
    let settings = (run.settings_toml.as_str(), run.task_settings.as_str());
    let origin = Origin::of_episodes(&run.metadata, settings, world);
    let mut file = LogFile::begin((path.to_path_buf(), File::create(path)?), &origin)?;
    let mut summary = RecordSummary::default();
    for (index, episode) in episodes.iter().enumerate() {
        let mut collector = ShareCollector::evaluation(*episode, (run.weights, 0));
        let start = (episode.key(), ActionChoice::Mean);
        let played = play_episode(world, run.policy, start, |event| {
            collector.observe(&event);
            if let StepEvent::After(step) = event {
                on_step(index, step.step);
            }
        })?;
        collector.finish()?.iter().try_for_each(|share| file.write(share))?;
        summary.episodes.push(played);
    }
    summary.messages = file.finish((0, 0))?;
    summary.bytes = std::fs::metadata(path)?.len();
    Ok(summary)
}
