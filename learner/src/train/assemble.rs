//! Assembles the iteration's batch `D_k` from the rollouts of its slots. The batch depends neither on the actors that
//! computed the slots nor on their order of arrival.

use std::ops::Range;

use marl::{ActionKind, AgentBatch, AgentShape, Batch, Final, Problem};
use proto::{EnvironmentSpec, FeatureRole, FinalStep, RunDescription, TrajectoryChunk};

use crate::exchange::SlotRollout;

/// Sizes of an iteration's batch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// `B`, number of environments.
    pub environments: usize,
    /// `T`, steps of each environment.
    pub steps: usize,
    /// Steps between two stored recurrent states.
    pub hidden_every: usize,
    /// Features of the global state.
    pub state: usize,
    /// Sizes of each agent.
    pub agents: Vec<AgentLayout>,
}

/// Sizes of one agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AgentLayout {
    /// Features of the agent's observation.
    pub observation: usize,
    /// Dimensions of the agent's action.
    pub action: usize,
    /// Units of the agent's recurrent state; 0 without one.
    pub hidden: usize,
}

impl Layout {
    /// The sizes in `run`, for a batch of `environments`.
    #[must_use]
    pub fn of(run: &RunDescription, environments: usize) -> Self {
        let agents = run.environment.agents.iter().zip(&run.hidden_sizes);
        Self {
            environments,
            steps: run.slot_steps as usize,
            hidden_every: run.hidden_every as usize,
            state: run.environment.state.len(),
            agents: agents
                .map(|(agent, hidden)| AgentLayout {
                    observation: agent.observation.len(),
                    action: agent.action.size as usize,
                    hidden: *hidden as usize,
                })
                .collect(),
        }
    }
}

/// The environment as the algorithm sees it: sizes, kinds of actions, and which features carry a signal.
#[must_use]
pub fn problem(environment: &EnvironmentSpec) -> Problem {
    let is_signal = |place: &usize| environment.state[*place].role == FeatureRole::Signal;
    let signals = |places: &[u32]| -> Vec<usize> {
        places.iter().map(|&place| place as usize).filter(is_signal).collect()
    };
    let shape = |agent: &proto::AgentSpec| AgentShape {
        observation: agent.observation.len(),
        action: agent.action.size as usize,
        action_range: (agent.action.low, agent.action.high),
        kind: match agent.action.choices {
            None => ActionKind::Continuous,
            Some(choices) => ActionKind::Discrete { choices: choices as usize },
        },
        surprise_features: (0..agent.observation.len())
            .filter(|&index| agent.observation[index].role == FeatureRole::Signal)
            .collect(),
        seen: signals(&agent.seen),
        near: signals(&agent.near),
    };
    Problem {
        agents: environment.agents.iter().map(shape).collect(),
        state: environment.state.len(),
    }
}

/// Assembles `D_k` from all slots, time-major. Slots may have any number of environments: those of a slot follow those of
/// the slot before it, so the batch does not depend on how environments are cut into slots.
///
/// # Panics
/// If `rollouts` are not exactly the iteration's slots with all their steps. Actors cannot cause this, because their
/// messages were checked on arrival.
#[must_use]
pub fn assemble(layout: &Layout, rollouts: &[SlotRollout]) -> Batch {
    let slots = rollouts.iter().map(|rollout| rollout.slot as usize);
    assert!(slots.eq(0..rollouts.len()), "rollouts are not all slots in order");
    let mut batch = empty(layout);
    let mut first_environment = 0;
    for rollout @ SlotRollout { slot, chunks, .. } in rollouts {
        let (mut steps, environments) = (0, rollout.environments());
        for chunk in chunks {
            assert_eq!(chunk.first_step as usize, steps, "slot {slot}: first step of a chunk");
            place(layout, first_environment..first_environment + environments, chunk, &mut batch);
            steps += chunk.steps as usize;
        }
        assert_eq!(steps, layout.steps, "slot {slot}: steps");
        first_environment += environments;
    }
    assert_eq!(first_environment, layout.environments, "environments of all slots");
    batch.finals.sort_by_key(|last| (last.step, last.environment));
    batch
}

fn empty(layout: &Layout) -> Batch {
    let environments = layout.environments;
    let rows = layout.steps * environments;
    let agent = |shape: &AgentLayout| AgentBatch {
        observation: vec![0.0; rows * shape.observation],
        action: vec![0.0; rows * shape.action],
        log_prob: vec![0.0; rows],
        hidden: vec![0.0; rows / layout.hidden_every * shape.hidden],
    };
    Batch {
        steps: layout.steps,
        environments,
        agents: layout.agents.iter().map(agent).collect(),
        state: vec![0.0; rows * layout.state],
        reward: vec![0.0; rows],
        terminated: vec![false; rows],
        truncated: vec![false; rows],
        finals: Vec::new(),
    }
}

/// Copies one chunk of a slot with these `environments` into the batch.
fn place(layout: &Layout, environments: Range<usize>, chunk: &TrajectoryChunk, batch: &mut Batch) {
    let window = Window {
        first: chunk.first_step as usize,
        steps: chunk.steps as usize,
        first_environment: environments.start,
        per_slot: environments.len(),
        environments: layout.environments,
    };
    window.copy(&chunk.state, &mut batch.state, layout.state);
    window.copy(&chunk.reward, &mut batch.reward, 1);
    window.copy(&chunk.terminated, &mut batch.terminated, 1);
    window.copy(&chunk.truncated, &mut batch.truncated, 1);
    let every = layout.hidden_every;
    let stored = Window { first: window.first / every, steps: window.steps / every, ..window };
    for ((from, to), shape) in chunk.agents.iter().zip(&mut batch.agents).zip(&layout.agents) {
        window.copy(&from.observation, &mut to.observation, shape.observation);
        window.copy(&from.action, &mut to.action, shape.action);
        window.copy(&from.log_prob, &mut to.log_prob, 1);
        stored.copy(&from.hidden, &mut to.hidden, shape.hidden);
    }
    batch.finals.extend(chunk.finals.iter().map(|last| window.last(last)));
}

/// Position of a chunk's rows in `D_k`.
#[derive(Clone, Copy)]
struct Window {
    /// First step.
    first: usize,
    /// Steps of the chunk.
    steps: usize,
    /// First environment.
    first_environment: usize,
    /// Environments of the chunk.
    per_slot: usize,
    /// Environments of `D_k`.
    environments: usize,
}

impl Window {
    /// Copies `source`, `[t, per_slot, width]`, into `target`, `[T, environments, width]`.
    fn copy<T: Copy>(&self, source: &[T], target: &mut [T], width: usize) {
        let run = self.per_slot * width;
        assert_eq!(source.len(), self.steps * run, "a chunk's array");
        if run == 0 {
            return;
        }
        for (t, rows) in source.chunks_exact(run).enumerate() {
            let row = (self.first + t) * self.environments + self.first_environment;
            target[row * width..][..run].copy_from_slice(rows);
        }
    }

    fn last(&self, last: &FinalStep) -> Final {
        Final {
            step: last.step as usize,
            environment: self.first_environment + last.environment as usize,
            state: last.state.clone(),
            observation: last.observation.clone(),
        }
    }
}

#[cfg(test)]
mod tests;
