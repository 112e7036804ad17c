//! Collectors of log data, which the stepping thread calls during a lease. They only collect what is logged.

use proto::trajectory_log::{AgentStep, FinalObservation, Kind, Share, ShareEnd, Step};
use proto::{
    Episodes, EvaluationWork, Lease, RolloutWork, RunDescription, TrajectoryChunk,
    rollout_episode_id,
};
use sim::{EnvironmentBatch, Pose};

use super::shares::{LoggedShare, LoggedStep};
use crate::evaluation::PlayedStep;

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
fn head(run: &RunDescription, lease: &Lease) -> Share {
    Share {
        attempt: lease.attempt,
        seed: run.seed,
        weights_version: lease.weights.version.0,
        weights_sha256: lease.weights.digest.0.to_vec(),
        ..Share::default()
    }
}

/// Collects the log data of a slot.
pub(crate) struct RolloutCollector<'a> {
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
        Self {
            episodes,
            work,
            common: Share { iteration, slot, kind, ..head(run, lease) },
            begun: Vec::new(),
            open: vec![None; work.environments.len()],
            chunks: Vec::new(),
        }
    }

    /// Collects poses before step `step` of the slot and starts shares.
    pub(crate) fn collect(&mut self, step: u32, world: &dyn EnvironmentBatch) {
        for position in 0..self.open.len() {
            if step == 0 || world.episode_step(position) == 0 {
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
        let episode = world.episode(position);
        if !self.episodes.include_rollout(environment, episode) {
            return None;
        }
        let head = Share {
            episode_id: rollout_episode_id(environment, episode),
            first_step: world.episode_step(position),
            environment,
            episode,
            environment_state: world.encode(position).ok()?,
            ..self.common.clone()
        };
        self.begun.push(PartialShare { head, position, slot_step, poses: Vec::new() });
        Some(self.begun.len() - 1)
    }

    /// Stores a chunk.
    pub(crate) fn keep(&mut self, chunk: TrajectoryChunk) {
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
pub(crate) struct EvaluationCollector {
    share: LoggedShare,
    before: WorldSnapshot,
    /// Size of each agent's action.
    sizes: Vec<usize>,
}

/// Pose, state and observations of an environment at one time.
struct WorldSnapshot {
    pose: Pose,
    state: Vec<f32>,
    observations: Vec<Vec<f32>>,
}

impl WorldSnapshot {
    /// Reads environment 0.
    fn of(world: &dyn EnvironmentBatch) -> Self {
        let description = world.description();
        let mut state = vec![0.0; description.state.len()];
        world.state(0, &mut state);
        let observe = |(agent, shape): (usize, &sim::AgentDescription)| {
            let mut row = vec![0.0; shape.observation.len()];
            world.observation(0, agent, &mut row);
            row
        };
        let observations = description.agents.iter().enumerate().map(observe).collect();
        Self { pose: world.pose(0), state, observations }
    }
}

impl EvaluationCollector {
    /// Starts a collector for `world` at the start of an episode; `None` if its state cannot be encoded.
    pub(crate) fn new(
        run: &RunDescription,
        lease: &Lease,
        work: EvaluationWork,
        world: &dyn EnvironmentBatch,
    ) -> Option<Self> {
        let EvaluationWork { iteration, episode } = work;
        let head = Share {
            episode_id: format!("evaluation-{iteration}-{episode}"),
            kind: Kind::Evaluation.into(),
            iteration,
            episode: episode.into(),
            environment_state: world.encode(0).ok()?,
            ..head(run, lease)
        };
        let sizes = world.description().agents.iter().map(|agent| agent.action.size).collect();
        let share = LoggedShare { head, steps: Vec::new(), end: ShareEnd::default() };
        Some(Self { share, before: WorldSnapshot::of(world), sizes })
    }

    /// Collects a step.
    pub(crate) fn collect(&mut self, played: &PlayedStep<'_>) {
        let WorldSnapshot { pose, state, observations } =
            std::mem::replace(&mut self.before, WorldSnapshot::of(played.world));
        let mut rest = played.action;
        let agent = |(observation, size): (Vec<f32>, &usize)| {
            let (action, others) = rest.split_at(*size);
            rest = others;
            AgentStep { observation, action: action.to_vec(), ..AgentStep::default() }
        };
        let agents = observations.into_iter().zip(&self.sizes).map(agent).collect();
        let sim::Outcome { reward, terminated, truncated, .. } = played.outcome;
        let step = Step { step: played.step - 1, reward, terminated, truncated, state };
        self.share.steps.push(LoggedStep { pose, agents, step });
    }

    /// Returns the share of the whole episode.
    pub(crate) fn finish(self) -> LoggedShare {
        let WorldSnapshot { state, observations, .. } = self.before;
        let observation = |observation| FinalObservation { observation };
        let end = ShareEnd {
            steps: self.share.steps.len() as u32,
            environment_state: Vec::new(),
            state,
            observations: observations.into_iter().map(observation).collect(),
        };
        LoggedShare { end, ..self.share }
    }
}
