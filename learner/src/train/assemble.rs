//! Assembles the iteration's batch `D_k` from the rollouts of its slots. The batch depends neither on the actors that
//! computed the slots nor on their order of arrival.

use std::ops::Range;

use marl::{ActionKind, AgentBatch, AgentShape, Batch, Final, Problem};
use proto::{AgentSpec, EnvironmentSpec, FeatureRole, FinalStep, RunDescription, TrajectoryChunk};

use crate::lease::slots::SlotRollout;

/// The environment as the algorithm sees it: sizes, kinds of actions, and which features carry a signal.
#[must_use]
pub fn problem(environment: &EnvironmentSpec) -> Problem {
    let shape = |agent: &AgentSpec| AgentShape {
        observation: agent.observation.len(),
        action: agent.action.size,
        action_range: (agent.action.low, agent.action.high),
        kind: match agent.action.choices {
            None => ActionKind::Continuous,
            Some(choices) => ActionKind::Discrete { choices: choices as usize },
        },
        surprise_features: (0..agent.observation.len())
            .filter(|&index| agent.observation[index].role == FeatureRole::Signal)
            .collect(),
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
pub fn assemble(run: &RunDescription, rollouts: &[SlotRollout]) -> Batch {
    let slots = rollouts.iter().map(|rollout| rollout.slot as usize);
    assert!(slots.eq(0..rollouts.len()), "rollouts are not all slots in order");
    let mut batch = empty(run, rollouts.iter().map(SlotRollout::environments).sum());
    let mut first_environment = 0;
    for rollout @ SlotRollout { slot, chunks, .. } in rollouts {
        let mut steps = 0;
        let environments = rollout.environments();
        for chunk in chunks {
            assert_eq!(chunk.first_step as usize, steps, "slot {slot}: first step of a chunk");
            place(run, first_environment..first_environment + environments, chunk, &mut batch);
            steps += chunk.steps as usize;
        }
        assert_eq!(steps, batch.steps, "slot {slot}: steps");
        first_environment += environments;
    }
    batch.finals.sort_by_key(|last| (last.step, last.environment));
    batch
}

fn empty(run: &RunDescription, environments: usize) -> Batch {
    let steps = run.slot_steps as usize;
    let rows = steps * environments;
    let agents = run.environment.agents.iter().zip(&run.hidden_sizes);
    let agent = |(agent, hidden): (&AgentSpec, &u32)| AgentBatch {
        observation: vec![0.0; rows * agent.observation.len()],
        action: vec![0.0; rows * agent.action.size],
        log_prob: vec![0.0; rows],
        hidden: vec![0.0; rows / run.hidden_every as usize * *hidden as usize],
    };
    Batch {
        steps,
        environments,
        agents: agents.map(agent).collect(),
        state: vec![0.0; rows * run.environment.state.len()],
        reward: vec![0.0; rows],
        terminated: vec![false; rows],
        truncated: vec![false; rows],
        finals: Vec::new(),
    }
}

/// Copies one chunk of a slot with these `environments` into the batch.
fn place(
    run: &RunDescription,
    environments: Range<usize>,
    chunk: &TrajectoryChunk,
    batch: &mut Batch,
) {
    let window = Window {
        first: chunk.first_step as usize,
        steps: chunk.steps as usize,
        first_environment: environments.start,
        per_slot: environments.len(),
        environments: batch.environments,
    };
    window.copy(&chunk.state, &mut batch.state, run.environment.state.len());
    window.copy(&chunk.reward, &mut batch.reward, 1);
    window.copy(&chunk.terminated, &mut batch.terminated, 1);
    window.copy(&chunk.truncated, &mut batch.truncated, 1);
    let every = run.hidden_every as usize;
    let stored = Window { first: window.first / every, steps: window.steps / every, ..window };
    for (i, (from, to)) in chunk.agents.iter().zip(&mut batch.agents).enumerate() {
        let agent = &run.environment.agents[i];
        window.copy(&from.observation, &mut to.observation, agent.observation.len());
        window.copy(&from.action, &mut to.action, agent.action.size);
        window.copy(&from.log_prob, &mut to.log_prob, 1);
        stored.copy(&from.hidden, &mut to.hidden, run.hidden_sizes[i] as usize);
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
pub(crate) mod tests;
