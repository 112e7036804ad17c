//! HAPPO with the paper's two terms: a sequential sweep over agents in random order.

use std::sync::Arc;

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{NamedArrays, PolicyConfig, PolicySnapshot, Precision};

use crate::algorithm::{Algorithm, Report};
use crate::batch::{Batch, Problem, Rewards};
use crate::config::{Config, Sharing};
use crate::error::MarlError;
use crate::minibatch::permutation;
use crate::on_policy::agent::Agent;
use crate::on_policy::ascent::{maximise, moved};
use crate::on_policy::kl_budget::KlBudget;
use crate::on_policy::{Prepared, Team, agent_report, critic_report, skipped_report};
use crate::phase::{Phase, PhaseObserver, during};
use crate::surrogate::{factor_limits, sequential_factor};

/// HAPPO and, by configuration alone, all its variants.
pub struct Happo {
    team: Team,
}

impl Happo {
    /// Networks for `problem`, their weights drawn with the seed of `start` and held in its precision.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn new(
        config: &Config,
        policy: &PolicyConfig,
        problem: &Problem,
        start: (RunSeed, Precision),
    ) -> Result<Self, MarlError> {
        Ok(Self { team: Team::new(config, policy, problem, start)? })
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

    fn observe_phases(&mut self, observer: Arc<dyn PhaseObserver>) {
        self.team.observer = observer;
    }

    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Rewards,
        iteration: u64,
    ) -> Result<Report, MarlError> {
        let Some(prepared) = self.team.prepare(batch, rewards, iteration)? else {
            return Ok(skipped_report());
        };
        let order = self.order(iteration);
        let Team { agents, critic, seed, observer, .. } = &mut self.team;
        let up = || sweep(agents, &prepared, &order, (*seed, iteration));
        let fit = || critic.fit(batch, &prepared.values, &prepared.returns, iteration);
        let (swept, fitted) = rayon::join(
            || during(&**observer, Phase::Sweep, up),
            || during(&**observer, Phase::Critic, fit),
        );
        let mut report = critic_report(&fitted?);
        report.extend(swept?);
        report.extend(prepared.report(self.team.config.critic_mode(), self.team.precision));
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
    let mut budget = KlBudget::new(agents[0].update.target_kl, agents.len());
    let mut factor = vec![1.0; prepared.experience[0].log_prob.len()];
    let mut reports = vec![Report::new(); agents.len()];
    for (position, &index) in order.iter().enumerate() {
        pass_optimiser(agents, index);
        let (agent, known) = (&mut agents[index], prepared.of(index));
        let draw = Draw::of(Purpose::Minibatch).iteration(iteration).agent(index as u32);
        let trained = maximise(agent, known, (&factor, budget.share()), (seed, draw))?;
        let moved = moved(agent, known.0)?;
        budget.spend(moved.kl);
        agent.adam.adapt(moved.kl, agent.update.desired_kl);
        reports[index] = agent_report(agent, index, known.0, &trained, &moved)?;
        reports[index].extend(place_in_the_sweep(index, position, &factor));
        factor = sequential_factor(&factor, &moved.log_prob, &known.0.log_prob);
        pass_optimiser(agents, index);
    }
    Ok(reports.concat())
}

/// Hands the optimiser of a network that all agents share, which is the first one's, to the agent `index`, or back.
fn pass_optimiser(agents: &mut [Agent], index: usize) {
    if agents[0].update.parameters == Sharing::Shared && index > 0 {
        let (first, others) = agents.split_at_mut(1);
        std::mem::swap(&mut first[0].adam, &mut others[index - 1].adam);
    }
}

/// When the agent was updated, and with what factor.
fn place_in_the_sweep(index: usize, position: usize, factor: &[f64]) -> Report {
    let count = factor.len() as f64;
    let mean = factor.iter().sum::<f64>() / count;
    let variance = factor.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count;
    let (lowest, highest) = factor_limits();
    let held = factor.iter().filter(|&&x| x <= lowest || x >= highest).count();
    let named = [
        ("sweep_position", position as f64),
        ("factor_mean", mean),
        ("factor_deviation", libm::sqrt(variance)),
        ("factor_smallest", factor.iter().fold(f64::INFINITY, |least, &x| least.min(x))),
        ("factor_largest", factor.iter().fold(f64::NEG_INFINITY, |most, &x| most.max(x))),
        ("factor_held", held as f64 / count),
    ];
    named.into_iter().map(|(name, value)| (format!("agent{index}/{name}"), value)).collect()
}
