//! The paper's letter (Eq. 10): the posterior climbs the influence term inside the policy's epochs.

use super::agent::{Agent, Experience, Influence};
use crate::config::QTraining;
use crate::error::MarlError;
use crate::head_rows::HeadRows;

impl Agent {
    /// One step of the posterior up the influence term of some chunks, before the policy's own, and
    /// what it says about every row after it; nothing unless it is trained jointly. The policy is a
    /// constant here as the posterior is in the policy's step: the two alternate.
    pub(super) fn climb_posterior(
        &mut self,
        experience: &Experience,
        influence: &mut Influence,
        columns: &[usize],
    ) -> Result<(), MarlError> {
        if self.q_training != QTraining::Joint {
            return Ok(());
        }
        let input = self.input(&experience.sequences, columns)?;
        let Some(posterior) = &mut self.posterior else { return Ok(()) };
        let layout = experience.sequences.layout;
        let p = HeadRows::of(&self.network.distribution(&self.network.weights()?, &input)?)?;
        let row = |step: usize| columns.iter().map(move |column| step * layout.chunks + column);
        let part: Vec<usize> = (0..layout.steps).flat_map(row).collect();
        let weight = (self.coefficients.lambda, self.coefficients.term);
        posterior.climb(&experience.conditions(), &part, &p, weight)?;
        influence.conditional = Some(posterior.conditional(&experience.conditions())?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use policy::{Draw, NamedArrays, Precision, Purpose, RunSeed};

    use super::super::agent::{fit_posteriors, gather};
    use super::super::ascent::maximise;
    use super::*;
    use crate::influence::mutual_information;
    use crate::probe;
    use crate::sequence::Layout;

    /// Two agents, what they have experienced, and what their posteriors say about it.
    fn prepared(q_training: QTraining) -> (Vec<Agent>, Vec<Experience>, Vec<Influence>) {
        let (problem, policy, batch, mut config) =
            (probe::problem(), probe::policy(), probe::batch(), probe::config());
        config.influence.q_training = q_training;
        let agent = |index| {
            Agent::new(&config, &policy, &problem, ((RunSeed(0), Precision::Single), index))
                .unwrap()
        };
        let mut agents = vec![agent(0), agent(1)];
        let layout = Layout::of(&batch, policy.chunk_steps);
        let advantage: Vec<f64> = batch.reward.iter().map(|&r| f64::from(r)).collect();
        let advantages = vec![advantage.clone(), advantage];
        let experience = gather(&agents, &batch, layout, &advantages).unwrap();
        let influence = fit_posteriors(&mut agents, &experience, RunSeed(0), 0).unwrap();
        (agents, experience, influence)
    }

    fn posterior(agent: &Agent) -> NamedArrays {
        agent.posterior.as_ref().unwrap().arrays(0).unwrap()
    }

    fn network(agent: &Agent) -> NamedArrays {
        agent.network.parameters().to_arrays("").unwrap()
    }

    /// Sum of the influence term over all rows, nats.
    fn term(agent: &Agent, experience: &Experience, influence: &Influence) -> f64 {
        let columns: Vec<usize> = (0..experience.sequences.layout.chunks).collect();
        let input = experience.sequences.input(&columns, agent.precision.dtype()).unwrap();
        let weights = agent.network.weights().unwrap();
        let head = agent.network.distribution(&weights, &input).unwrap();
        let p = HeadRows::of(&head).unwrap();
        let q = influence.conditional.clone().unwrap();
        let (
            HeadRows::Gaussian { mean: q_mean, sigma: q_sigma },
            HeadRows::Gaussian { mean, sigma },
        ) = (q, p)
        else {
            panic!("the probe's actions are continuous")
        };
        let rows = mean.chunks_exact(sigma.len()).zip(q_mean.chunks_exact(sigma.len()));
        rows.map(|(p, q)| agent.coefficients.term.row((q, &q_sigma), (p, &sigma)).0).sum()
    }

    #[test]
    fn all_rows_measure_the_estimate_before_a_joint_posterior_learns_from_them() {
        let (agents, experience, influence) = prepared(QTraining::Joint);
        let posterior = agents[0].posterior.as_ref().unwrap();
        let conditional = posterior.conditional(&experience[0].conditions()).unwrap();
        let rows: Vec<usize> = (0..experience[0].sequences.layout.rows()).collect();
        let log_q = conditional.log_prob(&experience[0].sequences.action, &rows);
        let expected = mutual_information(&log_q, &experience[0].log_prob);
        assert!(expected.is_some());
        assert_eq!(influence[0].mi_estimate, expected);
    }

    #[test]
    fn a_joint_step_moves_the_posterior_up_the_term_and_leaves_the_policys_network_alone() {
        let (mut agents, experience, mut influence) = prepared(QTraining::Joint);
        let (before, trunk) = (posterior(&agents[0]), network(&agents[0]));
        let columns: Vec<usize> = (0..experience[0].sequences.layout.chunks).collect();
        let start = term(&agents[0], &experience[0], &influence[0]);
        for _ in 0..20 {
            agents[0].climb_posterior(&experience[0], &mut influence[0], &columns).unwrap();
        }
        assert!(term(&agents[0], &experience[0], &influence[0]) > start);
        assert_ne!(posterior(&agents[0]), before);
        assert_eq!(network(&agents[0]), trunk);
    }

    #[test]
    fn a_posterior_trained_by_likelihood_is_not_touched_by_the_sweep_and_a_joint_one_is() {
        for (q_training, touched) in [(QTraining::Mle, false), (QTraining::Joint, true)] {
            let (mut agents, experience, influence) = prepared(q_training);
            let before = posterior(&agents[0]);
            let factor = vec![1.0; experience[0].log_prob.len()];
            let draw = Draw::of(Purpose::Minibatch);
            let known = (&experience[0], &influence[0]);
            maximise(&mut agents[0], known, (&factor, f64::INFINITY), (RunSeed(0), draw)).unwrap();
            assert_eq!(posterior(&agents[0]) != before, touched);
        }
    }
}
