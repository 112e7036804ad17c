//! MAPPO with the paper's two terms: all agents are updated at the same time, each against the others' behaviour
//! policies. They use one shared network or one each.

use policy::randomness::{Draw, Purpose, RunSeed};
use rayon::prelude::*;

use crate::config::Sharing;
use crate::error::MarlError;
use crate::rules::algorithm::Report;
use crate::rules::on_policy::agent::Agent;
use crate::rules::on_policy::ascent::{
    AgentInputs, AscentMetrics, PolicyChange, maximise, maximise_together, policy_change,
};
use crate::rules::on_policy::{PolicyUpdate, Prepared, agent_report};

/// MAPPO; its surrogate is HAPPO's with a factor of 1.
pub(crate) struct Mappo;

impl PolicyUpdate for Mappo {
    fn update_policies(
        &self,
        agents: &mut [Agent],
        prepared: &Prepared,
        key: (RunSeed, u64),
    ) -> Result<Report, MarlError> {
        let trained = update_jointly(agents, prepared, key)?;
        let changes =
            agents.iter().zip(&prepared.experience).map(|(agent, own)| policy_change(agent, own));
        let changes = changes.collect::<Result<Vec<_>, _>>()?;
        let mut report = Report::new();
        for (index, trained) in trained.iter().enumerate() {
            let agent = &agents[index];
            let experience = &prepared.experience[index];
            report.extend(agent_report(agent, index, experience, trained, &changes[index])?);
        }
        adapt_learning_rates(agents, &changes);
        Ok(report)
    }
}

/// Adapts every optimiser's learning rate to its policy's divergence; for a shared network, to the agents' mean
/// divergence.
fn adapt_learning_rates(agents: &mut [Agent], changes: &[PolicyChange]) {
    let desired = agents[0].update.desired_kl;
    match agents[0].update.parameters {
        Sharing::Shared => {
            let kl = changes.iter().map(|own| own.kl).sum::<f64>() / changes.len() as f64;
            agents[0].adam.adapt(kl, desired);
        }
        Sharing::Separate => {
            agents
                .iter_mut()
                .zip(changes)
                .for_each(|(agent, own)| agent.adam.adapt(own.kl, desired));
        }
    }
}

/// Updates all agents against the others' behaviour policies.
fn update_jointly(
    agents: &mut [Agent],
    prepared: &Prepared,
    (seed, iteration): (RunSeed, u64),
) -> Result<Vec<AscentMetrics>, MarlError> {
    let factor = vec![1.0; prepared.experience[0].log_prob.len()];
    let draw = |agent: usize| Draw::of(Purpose::Minibatch).iteration(iteration).agent(agent as u32);
    match agents[0].update.parameters {
        Sharing::Shared => {
            let inputs: Vec<AgentInputs<'_>> = (0..agents.len()).map(|i| prepared.of(i)).collect();
            let draws: Vec<Draw> = (0..agents.len()).map(draw).collect();
            maximise_together(agents, &inputs, &factor, (seed, &draws))
        }
        Sharing::Separate => {
            let one = |(index, agent): (usize, &mut Agent)| {
                maximise(agent, prepared.of(index), &factor, (seed, draw(index)))
            };
            agents.par_iter_mut().enumerate().map(one).collect()
        }
    }
}
