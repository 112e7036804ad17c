//! HAPPO with the paper's two terms: a sequential sweep over agents in random order.

use policy::randomness::{Draw, Purpose, RunSeed, generator};

use crate::config::Sharing;
use crate::error::MarlError;
use crate::objective::surrogate::{factor_limits, sequential_factor};
use crate::optimisation::minibatch::permutation;
use crate::rules::algorithm::Report;
use crate::rules::on_policy::agent::Agent;
use crate::rules::on_policy::ascent::{maximise, moved};
use crate::rules::on_policy::kl_budget::KlBudget;
use crate::rules::on_policy::{Climb, Prepared, agent_report};

/// HAPPO and, by configuration alone, all its variants.
pub(crate) struct Happo;

impl Climb for Happo {
    fn climb(
        &self,
        agents: &mut [Agent],
        prepared: &Prepared,
        (seed, iteration): (RunSeed, u64),
    ) -> Result<Report, MarlError> {
        let draw = Draw::of(Purpose::AgentOrder).iteration(iteration);
        let order = permutation(agents.len(), &mut generator(seed, draw));
        sweep(agents, prepared, &order, (seed, iteration))
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
        let trained = maximise(agent, known, &factor, budget.share(), (seed, draw))?;
        let moved = moved(agent, known.experience)?;
        budget.spend(moved.kl);
        agent.adam.adapt(moved.kl, agent.update.desired_kl);
        reports[index] = agent_report(agent, index, known.experience, &trained, &moved)?;
        reports[index].extend(place_in_the_sweep(index, position, &factor));
        factor = sequential_factor(&factor, &moved.log_prob, &known.experience.log_prob);
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
