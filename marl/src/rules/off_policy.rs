//! What learning rules with a replay have in common: when they learn, and the transitions that they learn from.
//!
//! The warm-up and the number of optimiser steps per iteration are counted in environment steps, so that a run does not
//! depend on which actors compute it. The snapshot determines whether actors act uniformly.

pub(crate) mod replay;

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorPolicy, PolicySnapshot};

use crate::config::{ReplaySettings, TrainingConfig};
use crate::data::batch::{Batch, Problem, check_rewards};
use crate::error::MarlError;
use crate::rules::algorithm::Report;
use crate::rules::off_policy::replay::{NStepHorizon, Replay, Sample};
use crate::state::Visitor;
use crate::surprise::{Relabelled, Surprise};

/// A replay, the draws from it, and the optimiser steps that are due.
pub(crate) struct ReplayedExperience {
    settings: ReplaySettings,
    horizon: NStepHorizon,
    problem: Problem,
    seed: RunSeed,
    replay: Replay,
    /// Sum over the optimiser steps since the last [`Self::add`] of [`Sample::bonus`], `[N]`; empty without surprise.
    bonus: Vec<f64>,
}

impl ReplayedExperience {
    /// An empty replay of transitions of `problem`; `seed` is the key of its draws.
    pub(crate) fn new(
        settings: ReplaySettings,
        config: &TrainingConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Self {
        Self {
            horizon: NStepHorizon { gamma: config.update.gamma, steps: settings.n_step },
            replay: Replay::new(problem, settings),
            problem: problem.clone(),
            settings,
            seed,
            bonus: Vec::new(),
        }
    }

    /// Optimiser steps that are due after the first `steps` environment steps.
    fn due(&self, steps: u64) -> u64 {
        let learning = steps.saturating_sub(self.settings.warm_up);
        libm::floor(self.settings.updates_per_step * learning as f64) as u64
    }

    /// Stores an iteration's transitions, with the team's rewards, and returns the number of optimiser steps that it makes
    /// due.
    ///
    /// # Errors
    /// If the batch does not match the problem; the error names the first invalid array.
    pub(crate) fn add(
        &mut self,
        batch: &Batch,
        rewards: &Relabelled<'_>,
    ) -> Result<u64, MarlError> {
        let agents = self.problem.agents.len();
        batch.check(&self.problem, 1, &vec![0; agents])?;
        check_rewards(&rewards.rewards, agents, batch.rows())?;
        let before = self.replay.rows_added();
        self.replay.add(batch)?;
        self.bonus.clear();
        Ok(self.due(self.replay.rows_added()) - self.due(before))
    }

    /// Cuts the episode of an environment off after its newest step.
    pub(crate) fn begin_again(&mut self, environment: usize) {
        self.replay.cut_off(environment);
    }

    /// The transitions of optimiser step `step` of `iteration`, whose rewards contain the surprise if there is one.
    ///
    /// # Errors
    /// If a tensor operation of a density fails.
    pub(crate) fn sample(
        &mut self,
        (iteration, step): (u64, u32),
        surprise: Option<&Surprise>,
    ) -> Result<Sample, MarlError> {
        let draw = Draw::of(Purpose::Replay).iteration(iteration).step(step);
        let mut rng = generator(self.seed, draw);
        let surprise = surprise.map(|surprise| (surprise, step));
        let sample = self.replay.sample(self.settings.batch, self.horizon, surprise, &mut rng)?;
        self.bonus.resize(sample.bonus.len(), 0.0);
        self.bonus.iter_mut().zip(&sample.bonus).for_each(|(sum, bonus)| *sum += bonus);
        Ok(sample)
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

    /// Size of the replay, the `updates` of the iteration, and the mean surprise bonus of the steps that they drew, per agent.
    pub(crate) fn report(&self, updates: u64) -> Report {
        let mut report = vec![
            ("replay/transitions".to_owned(), self.replay.len() as f64),
            ("replay/updates".to_owned(), updates as f64),
        ];
        for (agent, sum) in self.bonus.iter().enumerate() {
            report.push((format!("agent{agent}/surprise_replay_mean"), sum / updates as f64));
        }
        report
    }

    /// Visits `replay/*`.
    pub(crate) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.replay.visit(visitor)
    }
}
