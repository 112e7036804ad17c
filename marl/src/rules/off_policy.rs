//! What learning rules with a replay have in common: when they learn, and the transitions that they learn from.
//!
//! The warm-up and the number of optimiser steps per iteration are counted in environment steps, so that a run does not
//! depend on which actors compute it. The snapshot determines whether actors act uniformly.

pub(crate) mod replay;

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorPolicy, PolicyConfig, PolicySnapshot};

use crate::config::{HasacConfig, MaddpgConfig, TrainingConfig};
use crate::data::batch::{Batch, Problem, Rewards, check_rewards};
use crate::error::MarlError;
use crate::rules::algorithm::Report;
use crate::rules::off_policy::replay::{NStepHorizon, Replay, Sample};
use crate::state::Visitor;

/// Settings of a replay and of the learning from it; the rules' sections describe them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ReplaySettings {
    capacity: usize,
    batch: usize,
    n_step: usize,
    warm_up: u64,
    updates_per_step: f64,
}

impl From<&MaddpgConfig> for ReplaySettings {
    fn from(config: &MaddpgConfig) -> Self {
        Self {
            capacity: config.replay,
            batch: config.batch,
            n_step: config.n_step,
            warm_up: config.warm_up,
            updates_per_step: config.updates_per_step,
        }
    }
}

impl From<&HasacConfig> for ReplaySettings {
    fn from(config: &HasacConfig) -> Self {
        Self {
            capacity: config.replay,
            batch: config.batch,
            n_step: config.n_step,
            warm_up: config.warm_up,
            updates_per_step: config.updates_per_step,
        }
    }
}

/// A replay, the draws from it, and the optimiser steps that are due.
pub(crate) struct ReplayedExperience {
    settings: ReplaySettings,
    horizon: NStepHorizon,
    problem: Problem,
    chunk_steps: usize,
    seed: RunSeed,
    replay: Replay,
}

impl ReplayedExperience {
    /// An empty replay of transitions of `problem`; `seed` is the key of its draws.
    pub(crate) fn new(
        settings: ReplaySettings,
        (config, policy): (&TrainingConfig, &PolicyConfig),
        problem: &Problem,
        seed: RunSeed,
    ) -> Self {
        Self {
            horizon: NStepHorizon { gamma: config.update.gamma, steps: settings.n_step },
            replay: Replay::new(problem, settings.capacity),
            problem: problem.clone(),
            chunk_steps: policy.backpropagation_steps,
            settings,
            seed,
        }
    }

    /// Optimiser steps that are due after the first `steps` environment steps.
    fn due(&self, steps: u64) -> u64 {
        let learning = steps.saturating_sub(self.settings.warm_up);
        libm::floor(self.settings.updates_per_step * learning as f64) as u64
    }

    /// Stores an iteration's transitions and returns the number of optimiser steps that it makes due.
    ///
    /// # Errors
    /// If the batch does not match the problem; the error names the first invalid array.
    pub(crate) fn add(&mut self, batch: &Batch, rewards: &Rewards) -> Result<u64, MarlError> {
        let agents = self.problem.agents.len();
        batch.check(&self.problem, self.chunk_steps, &vec![0; agents])?;
        check_rewards(rewards, agents, batch.rows())?;
        let before = self.replay.rows_added();
        // Without surprise every agent's reward is the team's, which the replay stores once.
        self.replay.add(batch)?;
        Ok(self.due(self.replay.rows_added()) - self.due(before))
    }

    /// The transitions of optimiser step `step` of `iteration`.
    pub(crate) fn sample(&self, iteration: u64, step: u32) -> Sample {
        let draw = Draw::of(Purpose::Replay).iteration(iteration).step(step);
        self.replay.sample(self.settings.batch, self.horizon, &mut generator(self.seed, draw))
    }

    /// The policies for acting: uniform during the warm-up.
    pub(crate) fn snapshot(&self, agents: Vec<ActorPolicy>) -> PolicySnapshot {
        let warming_up = self.replay.rows_added() < self.settings.warm_up;
        PolicySnapshot {
            agents: if warming_up {
                agents.into_iter().map(ActorPolicy::uniform).collect()
            } else {
                agents
            },
        }
    }

    /// Size of the replay, and the `updates` of the iteration.
    pub(crate) fn report(&self, updates: u64) -> Report {
        vec![
            ("replay/transitions".to_owned(), self.replay.len() as f64),
            ("replay/updates".to_owned(), updates as f64),
        ]
    }

    /// Visits `replay/*`.
    pub(crate) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.replay.visit(visitor)
    }
}
