//! Reads the steps of an episode that is being played, as logs contain them.

use proto::trajectory_log::{AgentStep, FinalObservation, ShareEnd, Step};
use rollout::PlayedStep;
use sim::{EnvironmentBatch, Outcome, Pose};

use crate::share::LoggedStep;

/// Reads environment 0 before and after each step.
pub(crate) struct StepReader {
    before: WorldSnapshot,
    /// Size of each agent's action.
    sizes: Vec<usize>,
    steps: u32,
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
        let observe = |(agent, shape): (usize, &proto::AgentSpec)| {
            let mut row = vec![0.0; shape.observation.len()];
            world.observation(0, agent, &mut row);
            row
        };
        let observations = description.agents.iter().enumerate().map(observe).collect();
        Self { pose: world.pose(0), state, observations }
    }
}

impl StepReader {
    /// Starts at the start of an episode.
    pub(crate) fn new(world: &dyn EnvironmentBatch) -> Self {
        let sizes = world.description().agents.iter().map(|agent| agent.action.size).collect();
        Self { before: WorldSnapshot::of(world), sizes, steps: 0 }
    }

    /// Reads a step.
    pub(crate) fn read(&mut self, played: &PlayedStep<'_>) -> LoggedStep {
        let WorldSnapshot { pose, state, observations } =
            std::mem::replace(&mut self.before, WorldSnapshot::of(played.world));
        let mut rest = played.action;
        let agent = |(observation, size): (Vec<f32>, &usize)| {
            let (action, others) = rest.split_at(*size);
            rest = others;
            AgentStep { observation, action: action.to_vec(), ..AgentStep::default() }
        };
        let agents = observations.into_iter().zip(&self.sizes).map(agent).collect();
        let Outcome { reward, terminated, truncated, .. } = played.outcome;
        self.steps = played.step;
        let step = Step { step: played.step - 1, reward, terminated, truncated, state };
        LoggedStep { pose, agents, step }
    }

    /// The end of the share of all steps so far.
    pub(crate) fn end(self) -> ShareEnd {
        let WorldSnapshot { state, observations, .. } = self.before;
        let observation = |observation| FinalObservation { observation };
        ShareEnd {
            steps: self.steps,
            environment_state: Vec::new(),
            state,
            observations: observations.into_iter().map(observation).collect(),
        }
    }
}
