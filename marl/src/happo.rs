//! HAPPO with the paper's two terms: a sequential sweep over agents in random order.

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{NamedArrays, PolicyConfig, PolicySnapshot};

use crate::algorithm::{Algorithm, Report};
use crate::batch::{Batch, Problem, Rewards};
use crate::config::Config;
use crate::error::MarlError;
use crate::minibatch::permutation;
use crate::on_policy::agent::Agent;
use crate::on_policy::ascent::{log_prob, maximise};
use crate::on_policy::{Prepared, Team, agent_report, critic_report};
use crate::surrogate::sequential_factor;

/// HAPPO and, by configuration alone, all its variants.
pub struct Happo {
    team: Team,
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
        Ok(Self { team: Team::new(config, policy, problem, seed)? })
    }

    /// The order in which this iteration's sweep visits the agents.
    fn order(&self, iteration: u64) -> Vec<usize> {
        let draw = Draw::of(Purpose::AgentOrder).iteration(iteration);
        permutation(self.team.agents.len(), &mut generator(self.team.seed, draw))
    }
}

impl Algorithm for Happo {
    fn scale_learning_rates(&mut self, share: f64) {
        self.team.scale_learning_rates(share);
    }

    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Rewards,
        iteration: u64,
    ) -> Result<Report, MarlError> {
        let prepared = self.team.prepare(batch, rewards, iteration)?;
        let order = self.order(iteration);
        let Team { agents, critic, seed, .. } = &mut self.team;
        let (swept, fitted) = rayon::join(
            || sweep(agents, &prepared, &order, (*seed, iteration)),
            || critic.fit(batch, &prepared.values, &prepared.returns, iteration),
        );
        let mut report = critic_report(&fitted?);
        report.extend(swept?);
        report.extend(prepared.influence.iter().enumerate().flat_map(|(i, q)| q.report(i)));
        Ok(report)
    }

    fn snapshot(&self) -> Result<PolicySnapshot, MarlError> {
        self.team.snapshot()
    }

    fn arrays(&self) -> Result<NamedArrays, MarlError> {
        self.team.arrays()
    }

    fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError> {
        self.team.restore(arrays)
    }
}

/// Updates every agent in `order`, each weighing its advantage with what the ones before it did: the
/// factor `M` starts at 1 and takes in each updated agent's ratio to its behaviour.
fn sweep(
    agents: &mut [Agent],
    prepared: &Prepared,
    order: &[usize],
    (seed, iteration): (RunSeed, u64),
) -> Result<Report, MarlError> {
    let mut factor = vec![1.0; prepared.experience[0].log_prob.len()];
    let mut reports = vec![Report::new(); agents.len()];
    for (position, &index) in order.iter().enumerate() {
        let (agent, known) = (&mut agents[index], prepared.of(index));
        let draw = Draw::of(Purpose::Minibatch).iteration(iteration).agent(index as u32);
        let trained = maximise(agent, known, &factor, (seed, draw))?;
        reports[index] = agent_report(agent, index, &trained)?;
        reports[index].extend(place_in_the_sweep(index, position, &factor));
        let log_prob_new = log_prob(agent, known.0)?;
        factor = sequential_factor(&factor, &log_prob_new, &known.0.log_prob);
    }
    Ok(reports.concat())
}

/// When the agent was updated, and with what factor.
fn place_in_the_sweep(index: usize, position: usize, factor: &[f64]) -> Report {
    let mean = factor.iter().sum::<f64>() / factor.len() as f64;
    let largest = factor.iter().fold(f64::NEG_INFINITY, |most, &x| most.max(x));
    let named =
        [("sweep_position", position as f64), ("factor_mean", mean), ("factor_largest", largest)];
    named.into_iter().map(|(name, value)| (format!("agent{index}/{name}"), value)).collect()
}
