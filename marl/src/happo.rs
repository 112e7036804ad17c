//! HAPPO with the paper's two terms: a sequential sweep over agents in random order.

mod agent;
mod joint;
mod sweep;

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{NamedArrays, PolicyConfig, PolicySnapshot};
use rayon::prelude::*;

use crate::advantage::{Horizon, advantage};
use crate::algorithm::{Algorithm, Report};
use crate::batch::{ActionKind, Batch, Problem, Rewards};
use crate::config::Config;
use crate::critic::{Critic, CriticFigures, Values};
use crate::error::MarlError;
use crate::happo::agent::{Agent, Experience};
use crate::minibatch::permutation;
use crate::sequence::Layout;
use crate::surrogate::normalized_advantage;

/// HAPPO and, by configuration alone, all its variants.
pub struct Happo {
    config: Config,
    problem: Problem,
    chunk_steps: usize,
    seed: RunSeed,
    agents: Vec<Agent>,
    critic: Critic,
}

impl Happo {
    /// Networks for `problem`, their weights drawn with `seed`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn new(
        config: &Config,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        if problem.agents.iter().any(|agent| agent.kind != ActionKind::Continuous) {
            config.influence.check_for_choices()?;
        }
        let agents = (0..problem.agents.len())
            .map(|index| Agent::new(config, policy, problem, (seed, index)))
            .collect::<Result<_, _>>()?;
        let critic = Critic::new(&config.critic, config.update.adam_epsilon, problem, seed)?;
        let (config, problem) = (config.clone(), problem.clone());
        Ok(Self { config, problem, chunk_steps: policy.chunk_steps, seed, agents, critic })
    }

    /// Every agent's advantages and returns `[N][T, B]` under its own rewards.
    fn advantages(
        &self,
        batch: &Batch,
        rewards: &Rewards,
        values: &Values,
    ) -> (Vec<Vec<f32>>, Vec<Vec<f32>>) {
        let update = &self.config.update;
        let horizon = Horizon { gamma: update.gamma, lambda: update.gae_lambda };
        let agent = |agent: usize| {
            let (now, next) = (&values.now[agent], &values.next[agent]);
            let advantage = advantage(batch, &rewards[agent], now, next, horizon);
            let returns = advantage.iter().zip(now).map(|(a, v)| a + v).collect();
            (normalized_advantage(&advantage), returns)
        };
        (0..rewards.len()).into_par_iter().map(agent).unzip()
    }

    /// The order in which this iteration's sweep visits the agents.
    fn order(&self, iteration: u64) -> Vec<usize> {
        let draw = Draw::of(Purpose::AgentOrder).iteration(iteration);
        permutation(self.agents.len(), &mut generator(self.seed, draw))
    }
}

impl Algorithm for Happo {
    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Rewards,
        iteration: u64,
    ) -> Result<Report, MarlError> {
        let hidden: Vec<usize> = self.agents.iter().map(Agent::hidden_size).collect();
        batch.check(&self.problem, self.chunk_steps, &hidden)?;
        let layout = Layout::of(batch, self.chunk_steps);
        let values = self.critic.values(batch)?;
        let (advantages, returns) = self.advantages(batch, rewards, &values);
        let experience = agent::gather(&self.agents, batch, layout, &advantages)?;
        let posteriors =
            agent::fit_posteriors(&mut self.agents, &experience, self.seed, iteration)?;
        let order = self.order(iteration);
        let (agents, critic) = (&mut self.agents, &mut self.critic);
        let (swept, fitted) = rayon::join(
            || sweep::sweep(agents, &experience, &posteriors, &order, (self.seed, iteration)),
            || critic.fit(batch, &values, &returns, iteration),
        );
        let mut report = critic_report(&fitted?);
        report.extend(swept?);
        report.extend(posteriors.iter().enumerate().flat_map(|(i, p)| p.report(i)));
        Ok(report)
    }

    fn snapshot(&self) -> Result<PolicySnapshot, MarlError> {
        let agents = self.agents.iter().map(Agent::policy).collect::<Result<_, _>>()?;
        Ok(PolicySnapshot { agents })
    }

    fn arrays(&self) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.critic.arrays()?;
        for (index, agent) in self.agents.iter().enumerate() {
            arrays.append(&mut agent.arrays(index)?);
        }
        Ok(arrays)
    }

    fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError> {
        let known = self.arrays()?;
        let own = ["weights/", "optimizer/", "normalizer/"];
        let stored = arrays.keys().filter(|name| own.iter().any(|prefix| name.starts_with(prefix)));
        if let Some(name) = stored.into_iter().find(|name| !known.contains_key(*name)) {
            return Err(MarlError::Restore(format!("{name} belongs to nothing in this run")));
        }
        self.critic.restore(arrays)?;
        for (index, agent) in self.agents.iter_mut().enumerate() {
            agent.restore(index, arrays)?;
        }
        Ok(())
    }
}

fn critic_report(figures: &CriticFigures) -> Report {
    vec![
        ("losses/value_loss".to_owned(), figures.loss),
        ("losses/value_gradient_norm".to_owned(), figures.gradient_norm),
        ("losses/explained_variance".to_owned(), figures.explained_variance),
        ("losses/value_skipped_steps".to_owned(), figures.skipped as f64),
    ]
}

/// What the sweep holds constant for one agent, all in chunked order.
type PerAgent<'a> = (&'a Experience, &'a agent::Influence);
