//! Surprise minimisation: densities fitted on `D_k`, and their rewards.
//!
//! If all agents see the same signal features (the tasks' `full_id` observations), all densities and rewards are equal,
//! except for the draws of densities with networks. Surprise is individual only if observations are.

mod agent;

use policy::randomness::RunSeed;
use rayon::prelude::*;

use crate::config::SurpriseConfig;
use crate::data::batch::{AgentShape, Batch, Problem, Rewards};
use crate::density::{self, DensityContext, Observations};
use crate::error::MarlError;
use crate::rules::algorithm::Report;
use crate::shape::assert_shape;
use crate::state::{StoredState, Visitor};
use crate::surprise::agent::AgentSurprise;

/// Eq. (2): `sum_t H(s_t) <= - sum_t E[log p_theta(s_t)]`; the right-hand side per step: minus the mean log-density of
/// the visited rows, `[R]`, nats. It bounds their entropy from above, with equality where `p_theta` is the true
/// density.
pub(crate) fn entropy_bound(log_prob: &[f64]) -> f64 {
    -log_prob.iter().sum::<f64>() / log_prob.len() as f64
}

/// Eq. (3): `r~ = r + alpha log p_theta(s)`, the reward with surprise.
pub(crate) fn reward_with_surprise(reward: f64, alpha: f64, log_prob: f64) -> f64 {
    reward + alpha * log_prob
}

/// `sum |alpha s_t| / (sum |r_t| + sum |alpha s_t|)`: the fraction of an agent's reward, in magnitude, that is
/// surprise. Scores `s` and task rewards `r` are `[R]`. 0 if all are 0.
///
/// # Panics
/// If the shapes differ.
pub(crate) fn share_of_reward(reward: &[f32], alpha: f64, scores: &[f64]) -> f64 {
    assert_shape("scores", scores.len(), reward.len());
    let task: f64 = reward.iter().map(|&reward| f64::from(reward).abs()).sum();
    let bonus: f64 = scores.iter().map(|score| (alpha * score).abs()).sum();
    if bonus > 0.0 { bonus / (task + bonus) } else { 0.0 }
}

/// Rewards of an iteration.
pub struct Relabelled<'a> {
    /// Of every agent, `[N][T, B]`.
    pub rewards: Rewards,
    /// The densities whose surprise the rewards contain; a replay relabels its rewards with them when it draws them. `None`
    /// if every reward is the team's.
    pub surprise: Option<&'a Surprise>,
}

/// One density per agent, and the weight of its log-density in the agent's reward.
pub struct Surprise {
    seed: RunSeed,
    alpha: f64,
    /// Iteration of the last fit, the key of the draws of every query.
    iteration: u64,
    agents: Vec<AgentSurprise>,
}

impl Surprise {
    /// Unfitted densities, one per agent. `seed` is the key of all their random draws.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub fn new(
        config: &SurpriseConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let agent = |(index, shape): (usize, &AgentShape)| {
            let signal = &shape.surprise_features;
            let key = (seed, index as u32);
            Ok(AgentSurprise::new(density::build(config.density, signal, key)?))
        };
        let agents = problem.agents.iter().enumerate().map(agent);
        let agents = agents.collect::<Result<_, MarlError>>()?;
        Ok(Self { seed, alpha: config.alpha, iteration: 0, agents })
    }

    /// Eq. (2): `theta_k = argmax sum_(D_k) log p_theta(o)` for every agent. Also scores `D_k` under these
    /// densities.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub fn refit(&mut self, batch: &Batch, iteration: u64) -> Result<(), MarlError> {
        let rows = batch.rows();
        let alpha = self.alpha;
        let seed = self.seed;
        self.iteration = iteration;
        let agents = self.agents.par_iter_mut().enumerate();
        agents.try_for_each(|(index, agent)| {
            let data = &batch.agents[index].observation;
            let observations = Observations { data, width: data.len() / rows };
            let context = DensityContext { seed, iteration, agent: index as u32, query: 0 };
            agent.refit(observations, context, alpha)?;
            agent.share = share_of_reward(&batch.reward, alpha, agent.scores());
            Ok(())
        })
    }

    /// Eq. (9): `r~(s_t, o_t^i) = r(s_t) + alpha log p_theta^i(o_t^i)`, per agent `[T, B]`. It scores the observation
    /// before the step, never a terminal one.
    ///
    /// # Panics
    /// If `batch` has another shape than that of the last [`Surprise::refit`].
    #[must_use]
    pub fn relabel(&self, batch: &Batch) -> Relabelled<'_> {
        let agent = |agent: &AgentSurprise| {
            assert_shape("rows of the refitted batch", agent.scores().len(), batch.rows());
            self.with_surprise(&batch.reward, agent.scores())
        };
        let rewards = self.agents.par_iter().map(agent).collect();
        Relabelled { rewards, surprise: (self.alpha > 0.0).then_some(self) }
    }

    /// Eq. (9) for steps of any iteration, drawn for optimiser step `step`, with the densities of the last fit: rewards `[R]`
    /// and observations `[N][R, obs]` give `[N][R]`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn rewards(
        &self,
        reward: &[f32],
        observations: &[Vec<f32>],
        step: u32,
    ) -> Result<Rewards, MarlError> {
        let agents = self.agents.par_iter().zip(observations).enumerate();
        let agent = |(index, (agent, data)): (usize, (&AgentSurprise, &Vec<f32>))| {
            let observations = Observations { data, width: data.len() / reward.len() };
            let Self { seed, iteration, .. } = *self;
            let context = DensityContext { seed, iteration, agent: index as u32, query: step + 1 };
            Ok(self.with_surprise(reward, &agent.score(observations, context)?))
        };
        agents.map(agent).collect()
    }

    fn with_surprise(&self, reward: &[f32], scores: &[f64]) -> Vec<f32> {
        let pairs = reward.iter().map(|&reward| f64::from(reward)).zip(scores);
        let sum = |(reward, &score)| reward_with_surprise(reward, self.alpha, score) as f32;
        pairs.map(sum).collect()
    }

    /// Metrics of the last fit, per agent: entropy bound of the observations (nats), mean and standard deviation of the
    /// bonus per step (reward), its share of the return, and the numbers of active features and of features left out.
    #[must_use]
    pub fn report(&self) -> Report {
        let mut report = Report::new();
        for (i, agent) in self.agents.iter().enumerate() {
            let (bound, mean, deviation) = agent.at_fit();
            let (counted, masked) = agent.features();
            let mut add = |name: &str, value: f64| report.push((format!("agent{i}/{name}"), value));
            add("surprise_entropy_bound", bound);
            add("surprise_bonus_mean", mean);
            add("surprise_bonus_std", deviation);
            add("surprise_share", agent.share);
            add("surprise_features", counted as f64);
            add("surprise_masked", masked as f64);
        }
        report
    }
}

impl StoredState for Surprise {
    fn prefixes(&self) -> &'static [&'static str] {
        &["density/"]
    }

    /// Visits `density/agent_I.NAME`.
    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        let mut agents = self.agents.iter_mut().enumerate();
        agents.try_for_each(|(i, agent)| agent.visit(&format!("density/agent_{i}."), visitor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DensityKind;
    use crate::data::batch::AgentBatch;
    use crate::sample;

    fn surprise(alpha: f64, agents: usize) -> Surprise {
        let config = SurpriseConfig { alpha, density: DensityKind::DiagonalGaussian };
        let usual = sample::problem().agents.remove(0);
        let shape = AgentShape { observation: 1, surprise_features: vec![0], ..usual };
        let problem = Problem { agents: vec![shape; agents], state: 1 };
        Surprise::new(&config, &problem, RunSeed(0)).unwrap()
    }

    fn batch(observations: Vec<Vec<f32>>) -> Batch {
        let rows = observations[0].len();
        let agent = |observation| AgentBatch { observation, ..AgentBatch::default() };
        let agents = observations.into_iter().map(agent).collect();
        Batch { steps: rows, environments: 1, agents, reward: vec![2.0; rows], ..Batch::default() }
    }

    #[test]
    fn after_a_refit_the_bound_is_minimal_for_its_rows() {
        let (here, there) = (vec![0.0, 1.0, 2.0, 3.0], vec![10.0, 11.0, 12.0, 13.5]);
        let mut surprise = surprise(1.0, 1);
        surprise.refit(&batch(vec![there]), 0).unwrap();
        let stale = surprise.agents[0].log_prob(&here);
        surprise.refit(&batch(vec![here]), 1).unwrap();
        assert!(surprise.report()[0].1 < entropy_bound(&stale));
    }

    #[test]
    fn the_reward_increases_by_alpha_times_the_log_density() {
        assert_eq!(reward_with_surprise(2.0, 0.5, -3.0), 0.5);
    }

    #[test]
    fn a_bonus_of_one_and_a_reward_of_three_have_a_share_of_a_quarter() {
        assert_eq!(share_of_reward(&[1.0, -2.0], 0.5, &[-1.5, 0.5]), 0.25);
        assert_eq!(share_of_reward(&[0.0, 0.0], 0.0, &[-1.5, 0.5]), 0.0);
    }

    #[test]
    fn every_agents_reward_uses_the_density_of_its_own_observation() {
        let batch = batch(vec![vec![0.0, 2.0, 4.0], vec![5.0, 5.0, 8.0]]);
        let mut surprise = surprise(0.1, 2);
        surprise.refit(&batch, 0).unwrap();
        let rewards = surprise.relabel(&batch).rewards;
        for (seen, rewards, mean, variance) in [
            ([0.0, 2.0, 4.0], &rewards[0], 2.0, 8.0 / 3.0),
            ([5.0, 5.0, 8.0], &rewards[1], 6.0, 2.0),
        ] {
            for (x, reward) in seen.iter().zip(rewards) {
                let z = (x - mean) * (x - mean) / variance;
                let by_hand = 2.0 + 0.1 * (-0.5 * z - 0.5 * libm::log(variance));
                assert!((f64::from(*reward) - by_hand).abs() < 1e-6, "{reward} {by_hand}");
            }
        }
    }

    #[test]
    fn with_alpha_zero_the_reward_is_the_teams() {
        let batch = batch(vec![vec![0.5, -2.0, 4.0]]);
        let mut surprise = surprise(0.0, 1);
        surprise.refit(&batch, 0).unwrap();
        let relabelled = surprise.relabel(&batch);
        assert!(relabelled.rewards[0] == batch.reward && relabelled.surprise.is_none());
    }
}
