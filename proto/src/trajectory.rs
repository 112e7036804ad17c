//! Results of actors: chunks of a slot, results of evaluation episodes. Rows are time-major, `row = t * E + e`.
//! `validate.rs` checks received chunks.

use bytes::Bytes;

use crate::sizes::Sizes;
use crate::{Digest, RolloutOrigin, RunDescription, digest, left_out, tensor, wire};

/// Consecutive steps of one slot: `t` steps of `E` environments.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrajectoryChunk {
    /// Index of the chunk in the slot, from 0.
    pub sequence: u32,
    /// First step, relative to the slot's first.
    pub first_step: u32,
    /// `t`.
    pub steps: u32,
    /// One for each agent.
    pub agents: Vec<AgentChunk>,
    /// `[t, E, S]`, before each step.
    pub state: Vec<f32>,
    /// `[t, E]`, extrinsic, for the whole team.
    pub reward: Vec<f32>,
    /// `[t, E]`: the episode reached a terminal state.
    pub terminated: Vec<bool>,
    /// `[t, E]`: the episode was truncated; never together with `terminated`.
    pub truncated: Vec<bool>,
    /// For every step that ends an episode, and each environment's last step of the slot; ordered by
    /// `(step, environment)`, without duplicates.
    pub finals: Vec<FinalStep>,
    /// Present only in the slot's last chunk.
    pub end: Option<SlotEnd>,
}

/// One agent's part of a chunk.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AgentChunk {
    /// `[t, E, obs]`, before each step.
    pub observation: Vec<f32>,
    /// `[t, E, act]`, before the world clamps it.
    pub action: Vec<f32>,
    /// `[t, E]`, summed over action dimensions.
    pub log_prob: Vec<f32>,
    /// `[t / hidden_every, E, H]`, before the step and after any reset.
    pub hidden: Vec<f32>,
}

/// Result of a step whose next state is not in the following row.
#[derive(Clone, Debug, PartialEq)]
pub struct FinalStep {
    /// Relative to the slot's first step.
    pub step: u32,
    /// Index in the slot.
    pub environment: u32,
    /// True next state, `[S]`.
    pub state: Vec<f32>,
    /// True next observation of each agent, `[obs]`.
    pub observation: Vec<Vec<f32>>,
}

/// States of the slot's environments after its last step.
#[derive(Clone, Debug, PartialEq)]
pub struct SlotEnd {
    /// `[E]` encoded states, after any reset.
    pub environments: Vec<Vec<u8>>,
    /// For each agent `[E, H]`, zeros after a reset.
    pub recurrent: Vec<Vec<f32>>,
}

/// Result of one evaluation episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvaluationResult {
    /// Index of the episode.
    pub episode: u32,
    /// Sum of extrinsic rewards.
    pub extrinsic_return: f64,
    /// Length of the episode in steps.
    pub steps: u32,
}

impl TrajectoryChunk {
    /// SHA-256 over the canonical bytes that `trajectory.proto` documents. It covers the slot and values, not shapes.
    #[must_use]
    pub fn digest(&self, origin: &RolloutOrigin) -> Digest {
        digest::of_chunk(&self.message(self.steps), origin)
    }

    /// The message for it, without the observations that the learner restores, and its digest as a chunk of the slot
    /// `origin`.
    ///
    /// # Panics
    /// If the arrays do not have the sizes of the run and the slot.
    #[must_use]
    pub fn to_wire(
        &self,
        run: &RunDescription,
        origin: &RolloutOrigin,
    ) -> (wire::TrajectoryChunk, Digest) {
        let sizes = Sizes::of(run, origin);
        let (t, e) = (sizes.steps, sizes.environments);
        assert_eq!(self.agents.len(), sizes.agents, "the chunk's agents are not the run's");
        assert_eq!(self.reward.len(), t * e, "the chunk's rewards are not [{t}, {e}]");
        let mut message = self.message(run.hidden_every);
        let digest = digest::of_chunk(&message, origin);
        if run.restores_observations {
            left_out::leave_out(&mut message, &sizes);
        }
        (message, digest)
    }

    /// The message, with the recurrent states of every `hidden_every`th step.
    fn message(&self, hidden_every: u32) -> wire::TrajectoryChunk {
        let rows = [self.steps as usize, self.reward.len() / self.steps as usize];
        let stored = [(self.steps / hidden_every) as usize, rows[1]];
        let agent = |agent: &AgentChunk| wire::AgentChunk {
            observation: Some(tensor::in_rows(&rows, &agent.observation)),
            action: Some(tensor::in_rows(&rows, &agent.action)),
            log_prob: Some(tensor::floats(&rows, &agent.log_prob)),
            hidden: Some(tensor::in_rows(&stored, &agent.hidden)),
        };
        wire::TrajectoryChunk {
            sequence: self.sequence,
            first_step: self.first_step,
            steps: self.steps,
            agents: self.agents.iter().map(agent).collect(),
            state: Some(tensor::in_rows(&rows, &self.state)),
            reward: Some(tensor::floats(&rows, &self.reward)),
            terminated: Some(tensor::flags(&rows, &self.terminated)),
            truncated: Some(tensor::flags(&rows, &self.truncated)),
            finals: Some(self.finals_message()),
            end: self.end.as_ref().map(SlotEnd::message),
        }
    }

    fn finals_message(&self) -> wire::FinalSteps {
        let rows = [self.finals.len()];
        let stacked = |of: &dyn Fn(&FinalStep) -> Vec<f32>| {
            tensor::in_rows(&rows, &self.finals.iter().flat_map(of).collect::<Vec<_>>())
        };
        let observation = |agent: usize| stacked(&|last| last.observation[agent].clone());
        let agents = self.finals.first().map_or(0, |last| last.observation.len());
        wire::FinalSteps {
            steps: self.finals.iter().map(|last| last.step).collect(),
            environments: self.finals.iter().map(|last| last.environment).collect(),
            state: Some(stacked(&|last| last.state.clone())),
            observations: (0..agents).map(observation).collect(),
        }
    }
}

impl SlotEnd {
    fn message(&self) -> wire::SlotEnd {
        let rows = [self.environments.len()];
        wire::SlotEnd {
            environments: self
                .environments
                .iter()
                .map(|state| Bytes::copy_from_slice(state))
                .collect(),
            recurrent: self.recurrent.iter().map(|all| tensor::in_rows(&rows, all)).collect(),
        }
    }
}

impl EvaluationResult {
    /// SHA-256 over the canonical bytes that `trajectory.proto` documents, for the policies after `iteration`.
    #[must_use]
    pub fn digest(&self, iteration: u64) -> Digest {
        digest::of_evaluation(&self.to_wire(), iteration)
    }

    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::EvaluationResult {
        let Self { episode, extrinsic_return, steps } = *self;
        wire::EvaluationResult { episode, extrinsic_return, steps }
    }
}
