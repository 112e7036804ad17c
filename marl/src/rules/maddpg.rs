//! MADDPG: deterministic actors that maximise central action values, trained from a replay. The snapshot determines
//! whether actors act uniformly or add noise to the mean.

mod agent;
mod q;

use policy::randomness::RunSeed;
use policy::{PolicyConfig, PolicySnapshot};
use rayon::prelude::*;

use crate::config::TrainingConfig;
use crate::data::batch::{Batch, Problem};
use crate::error::MarlError;
use crate::rules::algorithm::{Algorithm, PREFIXES, Report};
use crate::rules::maddpg::agent::{MaddpgAgent, StepMetrics};
use crate::rules::off_policy::ReplayedExperience;
use crate::rules::off_policy::replay::Sample;
use crate::state::{StoredState, Visitor};
use crate::surprise::Relabelled;

/// MADDPG with one action value per agent.
pub(crate) struct Maddpg {
    agents: Vec<MaddpgAgent>,
    experience: ReplayedExperience,
}

impl Maddpg {
    /// Networks for `problem`, with weights initialised by `seed`, and an empty replay.
    ///
    /// # Errors
    /// If a tensor operation fails.
    ///
    /// # Panics
    /// If the settings are those of another rule.
    pub(crate) fn new(
        config: &TrainingConfig,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let agents = (0..problem.agents.len())
            .map(|index| MaddpgAgent::new(config, policy, problem, seed, index))
            .collect::<Result<_, _>>()?;
        let settings = config.replay().expect("the settings are those of a rule with a replay");
        let experience = ReplayedExperience::new(settings, config, problem, seed);
        Ok(Self { agents, experience })
    }

    /// One optimiser step of every agent, all with the same transitions.
    fn learn(&mut self, sample: &Sample) -> Result<Vec<StepMetrics>, MarlError> {
        let next = self.agents.par_iter().map(|agent| agent.next_actions(sample));
        let next = next.collect::<Result<Vec<_>, _>>()?;
        self.agents.par_iter_mut().map(|agent| agent.learn(sample, &next)).collect()
    }

    fn report(&self, updates: u64, sums: &[StepMetrics]) -> Report {
        let mut report = self.experience.report(updates);
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

    /// The agents share no noise.
    fn scale_noise(&mut self, _share: f64) {}

    fn begin_again(&mut self, environment: usize) {
        self.experience.begin_again(environment);
    }

    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Relabelled<'_>,
        iteration: u64,
    ) -> Result<Report, MarlError> {
        let updates = self.experience.add(batch, rewards)?;
        let mut sums = vec![StepMetrics::default(); self.agents.len()];
        for step in 0..updates {
            let sample = self.experience.sample((iteration, step as u32), rewards.surprise)?;
            for (sum, figures) in sums.iter_mut().zip(self.learn(&sample)?) {
                sum.value_loss += figures.value_loss;
                sum.action_value += figures.action_value;
                sum.gradient_norm += figures.gradient_norm;
            }
        }
        Ok(self.report(updates, &sums))
    }

    fn snapshot(&self) -> Result<PolicySnapshot, MarlError> {
        let agents = self.agents.iter().map(MaddpgAgent::policy).collect::<Result<_, _>>()?;
        Ok(self.experience.snapshot(agents))
    }
}

impl StoredState for Maddpg {
    fn prefixes(&self) -> &'static [&'static str] {
        &PREFIXES
    }

    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.agents.iter_mut().try_for_each(|agent| agent.visit(visitor))?;
        self.experience.visit(visitor)
    }
}
