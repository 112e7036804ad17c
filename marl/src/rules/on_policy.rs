//! The common part of rules that learn only from `D_k`: critic, advantages, posteriors and stored state. Each rule
//! implements the update of the policies.

pub(crate) mod agent;
pub(crate) mod ascent;
mod counted;
pub(crate) mod experience;
mod heads;

use std::sync::Arc;

use policy::{Head, PolicyConfig, PolicySnapshot, RunSeed};
use rayon::prelude::*;
use tracing::trace_span;

use crate::config::{Sharing, TrainingConfig};
use crate::critic::{Critic, CriticFigures, CriticMode, Values, explained_variance};
use crate::data::batch::{Batch, Problem, Rewards};
use crate::data::sequence::ChunkLayout;
use crate::distribution::gaussian;
use crate::error::MarlError;
use crate::objective::actor_loss::Figures;
use crate::objective::advantage::{Horizon, advantage};
use crate::objective::surrogate::normalized_advantage;
use crate::rounding::rounded;
use crate::rules::algorithm::{Algorithm, PREFIXES, Report};
use crate::rules::on_policy::agent::Agent;
use crate::rules::on_policy::ascent::{AgentInputs, AscentMetrics, PolicyChange};
use crate::rules::on_policy::experience::{Experience, Influence};
use crate::state::{StoredState, Visitor};
use crate::surprise::Relabelled;

/// A rule's update of the policies. The rest of an update is the same for all on-policy rules.
pub(crate) trait PolicyUpdate: Send + Sync {
    /// Updates the policies of `agents` and returns their metrics.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn update_policies(
        &self,
        agents: &mut [Agent],
        prepared: &Prepared,
        key: (RunSeed, u64),
    ) -> Result<Report, MarlError>;
}

/// A rule that learns only from `D_k`.
pub(crate) struct OnPolicy<R> {
    rule: R,
    team: Team,
}

impl<R: PolicyUpdate> OnPolicy<R> {
    /// Networks for `problem`, with weights initialised by `seed`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn new(
        rule: R,
        config: &TrainingConfig,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        Ok(Self { rule, team: Team::new(config, policy, problem, seed)? })
    }
}

impl<R: PolicyUpdate> Algorithm for OnPolicy<R> {
    fn scale_learning_rates(&mut self, share: f64) {
        self.team.scale_learning_rates(share);
    }

    fn scale_noise(&mut self, share: f64) {
        for agent in &mut self.team.agents {
            agent.network = Arc::new(agent.network.with_noise_share(share as f32));
        }
    }

    fn begin_again(&mut self, environment: usize) {
        self.team.critic.forget(environment);
    }

    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Relabelled<'_>,
        iteration: u64,
    ) -> Result<Report, MarlError> {
        let Some(prepared) = self.team.prepare(batch, &rewards.rewards, iteration)? else {
            // Returns are not finite.
            return Ok(vec![("losses/update_skipped".to_owned(), 1.0)]);
        };
        let Team { agents, critic, seed, .. } = &mut self.team;
        let update = || self.rule.update_policies(agents, &prepared, (*seed, iteration));
        let fit = || critic.fit(batch, &prepared.values, &prepared.returns, iteration);
        let (updated, fitted) = rayon::join(
            || trace_span!("policies").in_scope(update),
            || trace_span!("critic").in_scope(fit),
        );
        let mut report = critic_report(&fitted?);
        report.extend(updated?);
        report.extend(prepared.report(CriticMode::of(&self.team.config)));
        Ok(report)
    }

    fn snapshot(&self) -> Result<PolicySnapshot, MarlError> {
        self.team.snapshot()
    }
}

impl<R: PolicyUpdate> StoredState for OnPolicy<R> {
    fn prefixes(&self) -> &'static [&'static str] {
        &PREFIXES
    }

    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.team.visit(visitor)
    }
}

/// All agents and the critic.
pub(crate) struct Team {
    pub(crate) config: TrainingConfig,
    problem: Problem,
    chunk_steps: usize,
    pub(crate) seed: RunSeed,
    pub(crate) agents: Vec<Agent>,
    pub(crate) critic: Critic,
}

/// Inputs of an update, computed from `D_k` before any policy changes.
pub(crate) struct Prepared {
    pub(crate) experience: Vec<Experience>,
    pub(crate) influence: Vec<Influence>,
    pub(crate) values: Values,
    /// Targets of the critic, `[V][T, B]`.
    pub(crate) returns: Vec<Vec<f64>>,
}

impl Prepared {
    /// The inputs of one agent.
    pub(crate) fn of(&self, agent: usize) -> AgentInputs<'_> {
        AgentInputs { experience: &self.experience[agent], influence: &self.influence[agent] }
    }

    /// Explained variance of every agent's returns, and metrics of its posterior.
    pub(crate) fn report(&self, mode: CriticMode) -> Report {
        let mut report = Report::new();
        for (index, influence) in self.influence.iter().enumerate() {
            let of = |valued: &[Vec<f64>]| rounded(mode.of_agent(valued, index));
            let known = of(&self.values.now);
            let returns = of(&self.returns);
            let explained = explained_variance(&known, &returns);
            report.push((format!("agent{index}/explained_variance"), explained));
            report.extend(influence.report(index));
        }
        report
    }
}

impl Team {
    /// Networks for `problem`, with weights initialised by `seed`. Agents that share
    /// parameters share the network of agent 0.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn new(
        config: &TrainingConfig,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let mut agents = (0..problem.agents.len())
            .map(|index| Agent::new(config, policy, problem, seed, index))
            .collect::<Result<Vec<_>, _>>()?;
        if config.update.parameters == Sharing::Shared {
            let network = Arc::clone(&agents[0].network);
            let trainable = Arc::clone(&agents[0].trainable);
            for agent in &mut agents {
                (agent.network, agent.trainable) = (Arc::clone(&network), Arc::clone(&trainable));
            }
        }
        let chunk_steps = policy.backpropagation_steps;
        let values = CriticMode::of(config).values(problem.agents.len());
        let actors = (config.update.adam_epsilon, chunk_steps);
        let critic = Critic::new(&config.critic, actors, (problem.state, values), seed)?;
        let (config, problem) = (config.clone(), problem.clone());
        Ok(Self { config, problem, chunk_steps, seed, agents, critic })
    }

    pub(crate) fn scale_learning_rates(&mut self, share: f64) {
        self.critic.scale_learning_rate(share);
        self.agents.iter_mut().for_each(|agent| agent.adam.scale_learning_rate(share));
    }

    /// Checks the batch, computes its values and fits the posteriors. Returns `None`, without training, if a reward or
    /// value is not finite: the critic's running statistics of returns would never recover.
    ///
    /// # Errors
    /// If the batch does not match the problem.
    pub(crate) fn prepare(
        &mut self,
        batch: &Batch,
        rewards: &Rewards,
        iteration: u64,
    ) -> Result<Option<Prepared>, MarlError> {
        let hidden: Vec<usize> = self.agents.iter().map(Agent::hidden_size).collect();
        batch.check(&self.problem, self.chunk_steps, &hidden)?;
        let layout = ChunkLayout::of(batch, self.chunk_steps);
        let values = trace_span!("values").in_scope(|| self.critic.values(batch))?;
        self.critic.carry(&values);
        let valued = || self.advantages(batch, rewards, &values);
        let (advantages, returns) = trace_span!("advantages").in_scope(valued);
        if !returns.iter().flatten().all(|value| value.is_finite()) {
            return Ok(None);
        }
        let key = (self.seed, iteration);
        let gathered = || agent::gather(&self.agents, batch, layout, &advantages, key);
        let experience = trace_span!("behaviour").in_scope(gathered)?;
        let agents = &mut self.agents;
        let seed = self.seed;
        let fitted = || agent::fit_posteriors(agents, &experience, seed, iteration);
        let influence = trace_span!("posteriors").in_scope(fitted)?;
        Ok(Some(Prepared { experience, influence, values, returns }))
    }

    /// Every agent's normalised advantages `[N][T, B]`, and the critic's targets `[V][T, B]`.
    fn advantages(
        &self,
        batch: &Batch,
        rewards: &Rewards,
        values: &Values,
    ) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
        let update = &self.config.update;
        let horizon = Horizon { gamma: update.gamma, lambda: update.gae_lambda };
        let mode = CriticMode::of(&self.config);
        let valued = mode.rewards(&batch.reward, rewards);
        let one = |head: usize| {
            let (now, next) = (&values.now[head], &values.next[head]);
            let advantage = rounded(advantage(batch, &valued[head], now, next, horizon));
            let returns = advantage.iter().zip(now).map(|(a, v)| a + v).collect();
            (advantage, rounded(returns))
        };
        let (raw, returns): (Vec<_>, Vec<_>) = (0..valued.len()).into_par_iter().map(one).unzip();
        let own = |agent: usize| rounded(mode.of_agent(&raw, agent));
        let agent = |agent: usize| rounded(normalized_advantage(&own(agent)));
        ((0..rewards.len()).into_par_iter().map(agent).collect(), returns)
    }

    pub(crate) fn snapshot(&self) -> Result<PolicySnapshot, MarlError> {
        let agents = self.agents.iter().map(Agent::policy).collect::<Result<_, _>>()?;
        Ok(PolicySnapshot { agents })
    }

    /// Name of the owner of agent `index`'s network; `None` if an earlier agent owns it.
    fn owner(&self, index: usize) -> Option<String> {
        match (self.config.update.parameters, index) {
            (Sharing::Separate, _) => Some(format!("agent_{index}")),
            (Sharing::Shared, 0) => Some("shared".to_owned()),
            (Sharing::Shared, _) => None,
        }
    }

    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.critic.visit(visitor)?;
        for index in 0..self.agents.len() {
            if let Some(owner) = self.owner(index) {
                self.agents[index].visit_network(&owner, visitor)?;
            }
            self.agents[index].visit_posterior(index, visitor)?;
        }
        Ok(())
    }
}

/// Metrics of the critic's fit.
fn critic_report(figures: &CriticFigures) -> Report {
    vec![
        ("losses/value_loss".to_owned(), figures.loss),
        ("losses/value_gradient_norm".to_owned(), figures.gradient_norm),
        ("losses/explained_variance".to_owned(), figures.explained_variance),
        ("losses/value_skipped_steps".to_owned(), figures.skipped as f64),
        ("losses/update_skipped".to_owned(), 0.0),
    ]
}

/// Metrics of one agent's policy update.
pub(crate) fn agent_report(
    agent: &Agent,
    index: usize,
    experience: &Experience,
    trained: &AscentMetrics,
    change: &PolicyChange,
) -> Result<Report, MarlError> {
    let figures = &trained.figures;
    let named = [
        ("policy_loss", figures.policy_loss),
        ("approx_kl", figures.approx_kl),
        ("exact_kl", change.kl),
        ("clip_fraction", figures.clip_fraction),
        ("ratio_held", figures.clamped_fraction),
        ("gradient_norm", trained.gradient_norm),
        ("learning_rate", trained.learning_rate),
        ("skipped_steps", trained.skipped as f64),
        ("influence_kl", figures.influence),
        ("influence_capped", figures.capped_fraction),
        ("influence_share", figures.influence_share()),
    ];
    let equal = experience.advantage.iter().all(|&advantage| advantage == 0.0);
    let named = named.into_iter().chain([("advantages_equal", f64::from(u8::from(equal)))]);
    let named = named.chain(entropy_and_sigma(agent, figures)?);
    Ok(named.map(|(name, value)| (format!("agent{index}/{name}"), value)).collect())
}

/// Entropy and sigma: of a Gaussian after the update, of choices on average over the update.
fn entropy_and_sigma(
    agent: &Agent,
    figures: &Figures,
) -> Result<Vec<(&'static str, f64)>, MarlError> {
    let policy = agent.policy()?;
    let sigma: Vec<f64> = policy.sigma().iter().map(|&s| f64::from(s)).collect();
    Ok(match policy.head() {
        Head::Categorical { .. } => vec![("entropy", figures.entropy)],
        _ => {
            let mut named = vec![
                ("entropy", gaussian::entropy(&sigma)),
                ("sigma", sigma.iter().sum::<f64>() / sigma.len() as f64),
                ("sigma_smallest", sigma.iter().fold(f64::INFINITY, |least, &x| least.min(x))),
                ("sigma_floored", agent.floored(policy.sigma())),
            ];
            named.extend(policy.mean_loading().map(|found| ("noise_loading", found)));
            named
        }
    })
}

#[cfg(test)]
mod tests;
