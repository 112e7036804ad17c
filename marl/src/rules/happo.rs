//! HAPPO with the paper's two terms: sequential updates of the agents in random order.

use policy::randomness::{Draw, Purpose, RunSeed, generator};

use crate::config::Sharing;
use crate::error::MarlError;
use crate::objective::surrogate::{factor_limits, mean_and_deviation, sequential_factor};
use crate::optimisation::minibatch::permutation;
use crate::rules::algorithm::Report;
use crate::rules::on_policy::agent::Agent;
use crate::rules::on_policy::ascent::{maximise, policy_change};
use crate::rules::on_policy::{PolicyUpdate, Prepared, agent_report};

/// HAPPO; its variants differ only in configuration.
pub(crate) struct Happo;

impl PolicyUpdate for Happo {
    fn update_policies(
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

/// Updates the agents in `order`. The factor `M`, which multiplies an agent's advantages, starts at 1 and is multiplied
/// by the ratio of every updated agent.
fn sweep(
    agents: &mut [Agent],
    prepared: &Prepared,
    order: &[usize],
    (seed, iteration): (RunSeed, u64),
) -> Result<Report, MarlError> {
    let mut factor = vec![1.0; prepared.experience[0].log_prob.len()];
    let mut reports = vec![Report::new(); agents.len()];
    for (position, &index) in order.iter().enumerate() {
        swap_optimiser(agents, index);
        let agent = &mut agents[index];
        let inputs = prepared.of(index);
        let draw = Draw::of(Purpose::Minibatch).iteration(iteration).agent(index as u32);
        let trained = maximise(agent, inputs, &factor, (seed, draw))?;
        let change = policy_change(agent, inputs.experience)?;
        agent.adam.adapt(change.kl, agent.update.desired_kl);
        reports[index] = agent_report(agent, index, inputs.experience, &trained, &change)?;
        reports[index].extend(sweep_report(index, position, &factor));
        factor = sequential_factor(&factor, &change.log_prob, &inputs.experience.log_prob);
        swap_optimiser(agents, index);
    }
    Ok(reports.concat())
}

/// Swaps the optimiser of a shared network, which belongs to agent 0, with that of agent `index`.
fn swap_optimiser(agents: &mut [Agent], index: usize) {
    if agents[0].update.parameters == Sharing::Shared && index > 0 {
        let (first, others) = agents.split_at_mut(1);
        std::mem::swap(&mut first[0].adam, &mut others[index - 1].adam);
    }
}

/// The agent's position in the sweep, and statistics of its factor.
fn sweep_report(index: usize, position: usize, factor: &[f64]) -> Report {
    let (mean, deviation) = mean_and_deviation(factor);
    let (lowest, highest) = factor_limits();
    let held = factor.iter().filter(|&&x| x <= lowest || x >= highest).count();
    let named = [
        ("sweep_position", position as f64),
        ("factor_mean", mean),
        ("factor_deviation", deviation),
        ("factor_smallest", factor.iter().fold(f64::INFINITY, |least, &x| least.min(x))),
        ("factor_largest", factor.iter().fold(f64::NEG_INFINITY, |most, &x| most.max(x))),
        ("factor_held", held as f64 / factor.len() as f64),
    ];
    named.into_iter().map(|(name, value)| (format!("agent{index}/{name}"), value)).collect()
}
