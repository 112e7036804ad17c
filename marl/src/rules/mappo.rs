//! MAPPO with the paper's two terms: all agents climb at once, each as if the others stood still, with
//! one network for all of them or one each.

use policy::randomness::{Draw, Purpose, RunSeed};
use rayon::prelude::*;

use crate::config::Sharing;
use crate::error::MarlError;
use crate::rules::algorithm::Report;
use crate::rules::on_policy::agent::Agent;
use crate::rules::on_policy::ascent::{
    Moved, PerAgent, Trained, maximise, maximise_together, moved,
};
use crate::rules::on_policy::kl_budget::KlBudget;
use crate::rules::on_policy::{Climb, Prepared, agent_report};

/// MAPPO; its surrogate is HAPPO's with a factor of 1.
pub(crate) struct Mappo;

impl Climb for Mappo {
    fn climb(
        &self,
        agents: &mut [Agent],
        prepared: &Prepared,
        occasion: (RunSeed, u64),
    ) -> Result<Report, MarlError> {
        let trained = climb_together(agents, prepared, occasion)?;
        let asked = agents.iter().zip(&prepared.experience).map(|(agent, own)| moved(agent, own));
        let moved = asked.collect::<Result<Vec<_>, _>>()?;
        let mut report = Report::new();
        for (index, trained) in trained.iter().enumerate() {
            let (agent, experience) = (&agents[index], &prepared.experience[index]);
            report.extend(agent_report(agent, index, experience, trained, &moved[index])?);
        }
        adapt_steps(agents, &moved);
        Ok(report)
    }
}

/// Adapts every optimiser's step size to how far its policy moved; that of all agents to how far they moved on average.
fn adapt_steps(agents: &mut [Agent], moved: &[Moved]) {
    let desired = agents[0].update.desired_kl;
    match agents[0].update.parameters {
        Sharing::Shared => {
            let kl = moved.iter().map(|own| own.kl).sum::<f64>() / moved.len() as f64;
            agents[0].adam.adapt(kl, desired);
        }
        Sharing::Separate => {
            agents.iter_mut().zip(moved).for_each(|(agent, own)| agent.adam.adapt(own.kl, desired));
        }
    }
}

/// Updates all agents against the behaviour of all others.
fn climb_together(
    agents: &mut [Agent],
    prepared: &Prepared,
    (seed, iteration): (RunSeed, u64),
) -> Result<Vec<Trained>, MarlError> {
    let factor = vec![1.0; prepared.experience[0].log_prob.len()];
    let target_kl = agents[0].update.target_kl;
    let draw = |agent: usize| Draw::of(Purpose::Minibatch).iteration(iteration).agent(agent as u32);
    match agents[0].update.parameters {
        Sharing::Shared => {
            let known: Vec<PerAgent<'_>> = (0..agents.len()).map(|i| prepared.of(i)).collect();
            let draws: Vec<Draw> = (0..agents.len()).map(draw).collect();
            let together = KlBudget::new(target_kl, 1).share();
            maximise_together(agents, &known, &factor, together, (seed, &draws))
        }
        Sharing::Separate => {
            let share = KlBudget::new(target_kl, agents.len()).share();
            let one = |(index, agent): (usize, &mut Agent)| {
                maximise(agent, prepared.of(index), &factor, share, (seed, draw(index)))
            };
            agents.par_iter_mut().enumerate().map(one).collect()
        }
    }
}
