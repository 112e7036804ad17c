//! Rollout of a slot, from its lease to its last chunk: a pure function of the lease and the weights.

use std::ops::ControlFlow;

use policy::{Draw, DrawKey, PolicySnapshot, Purpose, RunSeed};
use proto::{RolloutWork, RunDescription, Start, TrajectoryChunk};
use sim::{EnvironmentBatch, Outcome, SimError};

use crate::acting::{Agents, DrawContext};
use crate::chunk::ChunkBuilder;
use crate::step_event::{PlayedStep, StepEvent};

/// A slot during its rollout.
struct Slot<'a> {
    run: &'a RunDescription,
    work: &'a RolloutWork,
    policy: &'a PolicySnapshot,
    world: &'a mut dyn EnvironmentBatch,
    agents: Agents,
    indices: Vec<u32>,
    outcomes: Vec<Outcome>,
    chunk: ChunkBuilder,
}

/// Rolls out all steps of `work` and passes each full chunk to `emit`, which can stop the rollout. Calls `on_event`
/// before and after each step.
///
/// # Errors
/// If an environment state of the lease is invalid, an action is not finite, or an external environment fails.
///
/// # Panics
/// If `world` and `work` have different numbers of environments.
pub fn roll_out(
    run: &RunDescription,
    work: &RolloutWork,
    policy: &PolicySnapshot,
    world: &mut dyn EnvironmentBatch,
    mut on_event: impl FnMut(StepEvent<'_>),
    mut emit: impl FnMut(TrajectoryChunk) -> ControlFlow<()>,
) -> Result<(), SimError> {
    let opened = world.count();
    let leased = work.environments.len();
    assert_eq!(opened, leased, "{opened} environments are open, the slot has {leased}");
    let mut slot = Slot::begin(run, work, policy, world)?;
    for step in 0..run.slot_steps {
        on_event(StepEvent::Before(step, slot.world));
        slot.step(step, &mut on_event)?;
        if let Some(chunk) = slot.full_chunk(step)?
            && emit(chunk).is_break()
        {
            break;
        }
    }
    Ok(())
}

impl<'a> Slot<'a> {
    fn begin(
        run: &'a RunDescription,
        work: &'a RolloutWork,
        policy: &'a PolicySnapshot,
        world: &'a mut dyn EnvironmentBatch,
    ) -> Result<Self, SimError> {
        let mut agents = Agents::new(world, policy);
        let mut continued = Vec::new();
        for (position, environment) in work.environments.iter().enumerate() {
            match &environment.start {
                Start::Fresh { episode, limit } => {
                    let indices = (position, environment.environment);
                    start_episode(world, RunSeed(run.seed), indices, *episode, *limit)?;
                }
                Start::Continue { state, recurrent } => {
                    continued.push((position, state.as_ref()));
                    agents.set_hidden(position, recurrent);
                }
            }
        }
        world.restore_all(&continued)?;
        Ok(Self {
            chunk: ChunkBuilder::new(0, 0, world),
            indices: work.environments.iter().map(|start| start.environment).collect(),
            outcomes: vec![Outcome::default(); world.count()],
            run,
            work,
            policy,
            world,
            agents,
        })
    }

    /// Observes, acts, steps, records, and resets finished episodes.
    fn step(
        &mut self,
        step: u32,
        on_event: &mut impl FnMut(StepEvent<'_>),
    ) -> Result<(), SimError> {
        if step.is_multiple_of(self.run.hidden_every) {
            self.chunk.store_hidden(&self.agents);
        }
        self.agents.observe(self.world);
        self.chunk.push_observation(&self.agents, self.world);
        self.agents.forward(self.policy);
        let seed = RunSeed(self.run.seed);
        let context = DrawContext { seed, iteration: self.work.iteration, step };
        self.agents.draw(self.policy, &self.indices, context);
        self.world.step(self.agents.join(), &mut self.outcomes)?;
        self.chunk.push_step(&self.agents, &self.outcomes, self.world);
        let played = self.agents.played(self.world, &self.outcomes, step + 1);
        let log_probs = Some(self.agents.log_prob.as_slice());
        on_event(StepEvent::After(PlayedStep { log_probs, ..played }));
        for position in 0..self.outcomes.len() {
            self.finish(step, position)?;
        }
        Ok(())
    }

    /// Stores the final state and observations if the step ended an episode or the slot. Starts the next episode if one
    /// has ended.
    fn finish(&mut self, step: u32, position: usize) -> Result<(), SimError> {
        let outcome = self.outcomes[position];
        let done = outcome.is_end();
        if done || step + 1 == self.run.slot_steps {
            self.chunk.push_final(step, position, self.world);
        }
        if !done {
            return Ok(());
        }
        let index = self.indices[position];
        if outcome.fault {
            let (iteration, slot) = (self.work.iteration, self.work.slot);
            tracing::warn!(
                iteration,
                slot,
                environment = index,
                step,
                "the state left its bounds; the episode is truncated"
            );
        }
        let (episode, limit) =
            (self.world.position(position).episode + 1, self.run.environment.episode_steps);
        start_episode(self.world, RunSeed(self.run.seed), (position, index), episode, limit)?;
        self.agents.reset_hidden(position);
        Ok(())
    }

    fn full_chunk(&mut self, step: u32) -> Result<Option<TrajectoryChunk>, SimError> {
        if step + 1 == self.run.slot_steps {
            self.chunk.close(&self.agents, self.world)?;
        }
        let full = self.chunk.steps() == self.run.chunk_steps;
        Ok(full.then(|| self.chunk.take(self.world)))
    }
}

/// Starts an episode of a run with this seed in the environment at `position` of `world`. Its draws are keyed by the indices
/// of the episode and of the environment in the run. `limit` is the number of steps until truncation.
///
/// # Errors
/// If an external environment fails.
pub fn start_episode(
    world: &mut dyn EnvironmentBatch,
    seed: RunSeed,
    (position, environment): (usize, u32),
    episode: u64,
    limit: u32,
) -> Result<(), SimError> {
    let draw = Draw::of(Purpose::Reset).iteration(episode).environment(environment);
    world.reset(position, episode, limit, DrawKey::of(seed, draw).0)
}
