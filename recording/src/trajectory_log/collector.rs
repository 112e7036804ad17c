//! Collectors of log data, which the stepping thread calls during a lease. They only collect what is logged.

use policy::RunSeed;
use proto::trajectory_log::{Kind, Share, ShareEnd};
use proto::{
    EpisodePosition, Episodes, Lease, RolloutWork, RunDescription, TrajectoryChunk, WeightsName,
    rollout_episode_id,
};
use rollout::{EvaluationEpisode, PlayedStep};
use sim::{EnvironmentBatch, Pose, SimError};

use crate::share::LoggedShare;
use crate::step_reader::StepReader;

/// Log data of a finished slot.
pub(crate) struct Rollout {
    pub(crate) begun: Vec<PartialShare>,
    /// Chunks in order, without those before the first share.
    pub(crate) chunks: Vec<TrajectoryChunk>,
}

/// The data of a share that the chunks do not contain.
pub(crate) struct PartialShare {
    pub(crate) head: Share,
    /// Index of its environment in the slot.
    pub(crate) position: usize,
    /// First step of the share in the slot.
    pub(crate) slot_step: u32,
    /// Poses before each step.
    pub(crate) poses: Vec<Pose>,
}

/// Header fields common to all shares of a lease.
fn head(seed: RunSeed, weights: WeightsName, attempt: u32) -> Share {
    Share {
        attempt,
        seed: seed.0,
        weights_version: weights.version.0,
        weights_sha256: weights.digest.0.to_vec(),
        ..Share::default()
    }
}

/// Collects the log data of a slot.
pub struct RolloutCollector<'a> {
    episodes: Episodes,
    work: &'a RolloutWork,
    common: Share,
    begun: Vec<PartialShare>,
    /// Index of the current share of each environment; `None` if it is not logged.
    open: Vec<Option<usize>>,
    chunks: Vec<TrajectoryChunk>,
}

impl<'a> RolloutCollector<'a> {
    pub(crate) fn new(
        episodes: Episodes,
        run: &RunDescription,
        lease: &Lease,
        work: &'a RolloutWork,
    ) -> Self {
        let (iteration, slot, kind) = (work.iteration, work.slot, Kind::Rollout.into());
        let head = head(RunSeed(run.seed), lease.weights, lease.attempt);
        Self {
            episodes,
            work,
            common: Share { iteration, slot, kind, ..head },
            begun: Vec::new(),
            open: vec![None; work.environments.len()],
            chunks: Vec::new(),
        }
    }

    /// Collects poses before step `step` of the slot and starts shares.
    pub fn collect(&mut self, step: u32, world: &dyn EnvironmentBatch) {
        for position in 0..self.open.len() {
            if step == 0 || world.position(position).step == 0 {
                self.open[position] = self.begin(step, position, world);
            }
            if let Some(index) = self.open[position] {
                self.begun[index].poses.push(world.pose(position));
            }
        }
    }

    /// Starts a share and returns its index; `None` if it is not logged or its state cannot be encoded.
    fn begin(
        &mut self,
        slot_step: u32,
        position: usize,
        world: &dyn EnvironmentBatch,
    ) -> Option<usize> {
        let environment = self.work.environments[position].environment;
        let EpisodePosition { episode, step: first_step, .. } = world.position(position);
        if !self.episodes.include_rollout(environment, episode) {
            return None;
        }
        let head = Share {
            episode_id: rollout_episode_id(environment, episode),
            first_step,
            environment,
            episode,
            environment_state: world.encode(position).ok()?,
            ..self.common.clone()
        };
        self.begun.push(PartialShare { head, position, slot_step, poses: Vec::new() });
        Some(self.begun.len() - 1)
    }

    /// Stores a chunk.
    pub fn keep(&mut self, chunk: TrajectoryChunk) {
        if !self.begun.is_empty() {
            self.chunks.push(chunk);
        }
    }

    /// Returns the data, if the slot is finished and has logged shares.
    pub(crate) fn finish(self) -> Option<Rollout> {
        let whole = self.chunks.last().is_some_and(|chunk| chunk.end.is_some());
        whole.then_some(Rollout { begun: self.begun, chunks: self.chunks })
    }
}

/// Collects the log data of an evaluation episode.
pub struct EvaluationCollector {
    share: LoggedShare,
    reader: StepReader,
}

impl EvaluationCollector {
    /// Starts a collector for `world` at the start of an episode of the weights, in their lease with number `attempt`.
    ///
    /// # Errors
    /// If the state cannot be encoded.
    pub(crate) fn new(
        episode: EvaluationEpisode,
        (weights, attempt): (WeightsName, u32),
        world: &dyn EnvironmentBatch,
    ) -> Result<Self, SimError> {
        let head = Share {
            environment_state: world.encode(0)?,
            ..evaluation_head(episode, weights, attempt)
        };
        let share = LoggedShare { head, steps: Vec::new(), end: ShareEnd::default() };
        Ok(Self { share, reader: StepReader::new(world) })
    }

    /// Collects a step.
    pub fn collect(&mut self, played: &PlayedStep<'_>) {
        self.share.steps.push(self.reader.read(played));
    }

    /// Returns the share of the whole episode.
    pub(crate) fn finish(self) -> LoggedShare {
        LoggedShare { end: self.reader.end(), ..self.share }
    }
}

/// Header of the share of a whole evaluation episode, without its state.
pub(crate) fn evaluation_head(
    episode: EvaluationEpisode,
    weights: WeightsName,
    attempt: u32,
) -> Share {
    Share {
        episode_id: episode.id(),
        kind: Kind::Evaluation.into(),
        iteration: episode.iteration,
        episode: episode.index.into(),
        ..head(episode.seed, weights, attempt)
    }
}
