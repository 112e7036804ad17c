//! Collects steps into the chunks that are sent to the learner.

use proto::{AgentChunk, FinalStep, SlotEnd, TrajectoryChunk};
use sim::{EnvironmentBatch, Outcome, SimError};

use crate::acting::Agents;

/// Builder of the current chunk.
#[derive(Debug)]
pub(crate) struct ChunkBuilder {
    chunk: TrajectoryChunk,
}

impl ChunkBuilder {
    /// Starts chunk number `sequence` of a slot, at step `first_step`.
    pub(crate) fn new(sequence: u32, first_step: u32, environments: &dyn EnvironmentBatch) -> Self {
        let description = environments.description();
        let chunk = TrajectoryChunk {
            sequence,
            first_step,
            agents: vec![AgentChunk::default(); description.agents.len()],
            ..TrajectoryChunk::default()
        };
        Self { chunk }
    }

    /// Adds the recurrent states before the next step.
    pub(crate) fn store_hidden(&mut self, agents: &Agents) {
        for (chunk, hidden) in self.chunk.agents.iter_mut().zip(&agents.hidden) {
            chunk.hidden.extend_from_slice(hidden);
        }
    }

    /// Adds the observations and the global states before a step.
    pub(crate) fn push_observation(
        &mut self,
        agents: &Agents,
        environments: &dyn EnvironmentBatch,
    ) {
        for (chunk, observation) in self.chunk.agents.iter_mut().zip(&agents.observation) {
            chunk.observation.extend_from_slice(observation);
        }
        let size = environments.description().state.len();
        for environment in 0..environments.count() {
            let state = &mut self.chunk.state;
            let start = state.len();
            state.resize(start + size, 0.0);
            environments.state(environment, &mut state[start..]);
        }
    }

    /// Adds the actions, log-probabilities and results of a step.
    pub(crate) fn push_step(&mut self, agents: &Agents, outcomes: &[Outcome]) {
        for (agent, chunk) in self.chunk.agents.iter_mut().enumerate() {
            chunk.action.extend_from_slice(&agents.action[agent]);
            chunk.log_prob.extend_from_slice(&agents.log_prob[agent]);
        }
        self.chunk.reward.extend(outcomes.iter().map(|outcome| outcome.reward));
        self.chunk.terminated.extend(outcomes.iter().map(|outcome| outcome.terminated));
        self.chunk.truncated.extend(outcomes.iter().map(|outcome| outcome.truncated));
        self.chunk.steps += 1;
    }

    /// Adds the final state and observations after step `step`, before any reset.
    pub(crate) fn push_final(
        &mut self,
        step: u32,
        environment: usize,
        world: &dyn EnvironmentBatch,
    ) {
        let (state, observation) =
            (world.state_of(environment), world.observations_of(environment));
        let environment = environment as u32;
        self.chunk.finals.push(FinalStep { step, environment, state, observation });
    }

    /// Number of steps in the chunk.
    pub(crate) fn steps(&self) -> u32 {
        self.chunk.steps
    }

    /// Returns the chunk and starts the next one.
    pub(crate) fn take(&mut self, environments: &dyn EnvironmentBatch) -> TrajectoryChunk {
        let sequence = self.chunk.sequence + 1;
        let first = self.chunk.first_step + self.chunk.steps;
        std::mem::replace(self, Self::new(sequence, first, environments)).chunk
    }

    /// Adds the final environment states and recurrent states of the slot to its last chunk.
    pub(crate) fn close(
        &mut self,
        agents: &Agents,
        environments: &dyn EnvironmentBatch,
    ) -> Result<(), SimError> {
        let environments = environments.encode_all()?;
        self.chunk.end = Some(SlotEnd { environments, recurrent: agents.hidden.clone() });
        Ok(())
    }
}
