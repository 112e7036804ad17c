//! MAPPO with the paper's two terms: all agents climb at once, each as if the others stood still, with
//! one network for all of them or one each.

use std::sync::Arc;

use policy::randomness::{Draw, Purpose, RunSeed};
use policy::{NamedArrays, PolicyConfig, PolicySnapshot, Precision};
use rayon::prelude::*;

use crate::algorithm::{Algorithm, Report};
use crate::batch::{Batch, Problem, Rewards};
use crate::config::{Config, Sharing};
use crate::error::MarlError;
use crate::on_policy::agent::Agent;
use crate::on_policy::ascent::{Moved, PerAgent, Trained, maximise, maximise_together, moved};
use crate::on_policy::kl_budget::KlBudget;
use crate::on_policy::{Prepared, Team, agent_report, critic_report, skipped_report};
use crate::phase::{Phase, PhaseObserver, during};

/// MAPPO; its surrogate is HAPPO's with a factor of 1.
pub struct Mappo {
    sharing: Sharing,
    team: Team,
}

impl Mappo {
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
        let sharing = config.update.parameters;
        Ok(Self { sharing, team: Team::new(config, policy, problem, start)? })
    }
}

impl Algorithm for Mappo {
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
        let (sharing, Team { agents, critic, seed, observer, .. }) = (self.sharing, &mut self.team);
        let up = || climb(agents, &prepared, sharing, (*seed, iteration));
        let fit = || critic.fit(batch, &prepared.values, &prepared.returns, iteration);
        let (climbed, fitted) = rayon::join(
            || during(&**observer, Phase::Sweep, up),
            || during(&**observer, Phase::Critic, fit),
        );
        let mut report = critic_report(&fitted?);
        let asked = agents.iter().zip(&prepared.experience).map(|(agent, own)| moved(agent, own));
        let moved = asked.collect::<Result<Vec<_>, _>>()?;
        for (index, trained) in climbed?.iter().enumerate() {
            let (agent, experience) = (&agents[index], &prepared.experience[index]);
            report.extend(agent_report(agent, index, experience, trained, &moved[index])?);
        }
        adapt_steps(agents, &moved, sharing);
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

/// Adapts every optimiser's step size to how far its policy moved; that of all agents to how far they moved on average.
fn adapt_steps(agents: &mut [Agent], moved: &[Moved], sharing: Sharing) {
    let desired = agents[0].update.desired_kl;
    match sharing {
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
fn climb(
    agents: &mut [Agent],
    prepared: &Prepared,
    sharing: Sharing,
    (seed, iteration): (RunSeed, u64),
) -> Result<Vec<Trained>, MarlError> {
    let factor = vec![1.0; prepared.experience[0].log_prob.len()];
    let target_kl = agents[0].update.target_kl;
    let draw = |agent: usize| Draw::of(Purpose::Minibatch).iteration(iteration).agent(agent as u32);
    match sharing {
        Sharing::Shared => {
            let known: Vec<PerAgent<'_>> = (0..agents.len()).map(|i| prepared.of(i)).collect();
            let draws: Vec<Draw> = (0..agents.len()).map(draw).collect();
            let together = KlBudget::new(target_kl, 1).share();
            maximise_together(agents, &known, (&factor, together), (seed, &draws))
        }
        Sharing::Separate => {
            let share = KlBudget::new(target_kl, agents.len()).share();
            let one = |(index, agent): (usize, &mut Agent)| {
                maximise(agent, prepared.of(index), (&factor, share), (seed, draw(index)))
            };
            agents.par_iter_mut().enumerate().map(one).collect()
        }
    }
}
