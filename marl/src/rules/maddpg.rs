//! MADDPG: deterministic actors that maximise central action values, trained from a replay.
//!
//! The warm-up and the number of optimiser steps per iteration are counted in environment steps, so that a run does not
//! depend on which actors compute it. The snapshot determines whether actors act uniformly or add noise to the mean.

mod agent;
mod q;
mod replay;

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{PolicyConfig, PolicySnapshot};
use rayon::prelude::*;

use crate::config::{MaddpgConfig, TrainingConfig};
use crate::data::batch::{Batch, Problem, Rewards, check_rewards};
use crate::error::MarlError;
use crate::rules::algorithm::{Algorithm, PREFIXES, Report};
use crate::rules::maddpg::agent::{MaddpgAgent, StepMetrics};
use crate::rules::maddpg::replay::{NStepHorizon, Replay};
use crate::state::{StoredState, Visitor};

/// MADDPG with one action value per agent.
pub(crate) struct Maddpg {
    config: MaddpgConfig,
    gamma: f64,
    problem: Problem,
    chunk_steps: usize,
    seed: RunSeed,
    agents: Vec<MaddpgAgent>,
    replay: Replay,
}

impl Maddpg {
    /// Networks for `problem`, with weights initialised by `seed`, and an empty replay.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn new(
        config: &TrainingConfig,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let agents = (0..problem.agents.len())
            .map(|index| MaddpgAgent::new(config, policy, problem, seed, index))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            replay: Replay::new(problem, config.maddpg.replay),
            gamma: config.update.gamma,
            config: config.maddpg.clone(),
            problem: problem.clone(),
            chunk_steps: policy.backpropagation_steps,
            seed,
            agents,
        })
    }

    /// Optimiser steps that are due after the first `steps` environment steps.
    fn due(&self, steps: u64) -> u64 {
        let learning = steps.saturating_sub(self.config.warm_up);
        libm::floor(self.config.updates_per_step * learning as f64) as u64
    }

    /// One optimiser step of every agent, all with the same transitions.
    fn learn(&mut self, draw: Draw) -> Result<Vec<StepMetrics>, MarlError> {
        let horizon = NStepHorizon { gamma: self.gamma, steps: self.config.n_step };
        let mut rng = generator(self.seed, draw);
        let sample = self.replay.sample(self.config.batch, horizon, &mut rng);
        let next = self.agents.par_iter().map(|agent| agent.next_actions(&sample));
        let next = next.collect::<Result<Vec<_>, _>>()?;
        self.agents.par_iter_mut().map(|agent| agent.learn(&sample, &next)).collect()
    }

    fn report(&self, updates: u64, sums: &[StepMetrics]) -> Report {
        let mut report = vec![
            ("replay/transitions".to_owned(), self.replay.len() as f64),
            ("replay/updates".to_owned(), updates as f64),
        ];
        if updates == 0 {
            return report;
        }
        let share = 1.0 / updates as f64;
        let count = self.agents.len() as f64;
        let loss: f64 = sums.iter().map(|sum| sum.value_loss).sum();
        report.push(("losses/value_loss".to_owned(), share * loss / count));
        for (index, (agent, sum)) in self.agents.iter().zip(sums).enumerate() {
            for (name, value) in [
                ("policy_loss", -share * sum.action_value),
                ("gradient_norm", share * sum.gradient_norm),
                ("skipped_steps", agent.skipped() as f64),
            ] {
                report.push((format!("agent{index}/{name}"), value));
            }
        }
        report
    }
}

impl Algorithm for Maddpg {
    fn scale_learning_rates(&mut self, share: f64) {
        self.agents.iter_mut().for_each(|agent| agent.scale_learning_rates(share));
    }

    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Rewards,
        iteration: u64,
    ) -> Result<Report, MarlError> {
        batch.check(&self.problem, self.chunk_steps, &vec![0; self.agents.len()])?;
        check_rewards(rewards, self.agents.len(), batch.rows())?;
        let before = self.replay.rows_added();
        // Without surprise every agent's reward is the team's, which the replay stores once.
        self.replay.add(batch)?;
        let updates = self.due(self.replay.rows_added()) - self.due(before);
        let mut sums = vec![StepMetrics::default(); self.agents.len()];
        for step in 0..updates {
            let draw = Draw::of(Purpose::Replay).iteration(iteration).step(step as u32);
            for (sum, figures) in sums.iter_mut().zip(self.learn(draw)?) {
                sum.value_loss += figures.value_loss;
                sum.action_value += figures.action_value;
                sum.gradient_norm += figures.gradient_norm;
            }
        }
        Ok(self.report(updates, &sums))
    }

    fn snapshot(&self) -> Result<PolicySnapshot, MarlError> {
        let agents = self.agents.iter().map(MaddpgAgent::policy).collect::<Result<Vec<_>, _>>()?;
        let warming_up = self.replay.rows_added() < self.config.warm_up;
        let agents = if warming_up {
            agents.into_iter().map(policy::ActorPolicy::uniform).collect()
        } else {
            agents
        };
        Ok(PolicySnapshot { agents })
    }
}

impl StoredState for Maddpg {
    fn prefixes(&self) -> &'static [&'static str] {
        &PREFIXES
    }

    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.agents.iter_mut().try_for_each(|agent| agent.visit(visitor))?;
        self.replay.visit(visitor)
    }
}
