//! The heads of an agent's network in an optimiser step: the policy's, and the paper's second head if Eq. (10) trains
//! both.

use policy::Distribution;
use policy::ops::Weights;

use super::agent::Agent;
use super::experience::Experience;
use crate::error::MarlError;
use crate::influence::second_head::SecondHead;

/// All weights of one optimiser step.
pub(super) enum StepWeights<'a> {
    /// Weights of a network with one head.
    One(Weights),
    /// Weights of trunk and policy head, and of the second head.
    Two { policy: [Weights; 2], second: &'a SecondHead, weights: [Weights; 2] },
}

impl Agent {
    /// The current weights.
    pub(super) fn step_weights(&self) -> Result<StepWeights<'_>, MarlError> {
        let Some(second) = &self.second_head else {
            return Ok(StepWeights::One(self.network.weights()?));
        };
        let policy = self.network.split_weights()?;
        let weights = second.weights()?;
        Ok(StepWeights::Two { policy, second, weights })
    }

    /// The policy `p` for the rows of some chunks, and `q` of a second head.
    pub(super) fn heads(
        &self,
        weights: &StepWeights<'_>,
        experience: &Experience,
        columns: &[usize],
    ) -> Result<(Distribution, Option<Distribution>), MarlError> {
        let input = experience.sequences.input(columns)?;
        match weights {
            StepWeights::One(own) => Ok((self.network.distribution(own, &input)?, None)),
            StepWeights::Two { policy, second, weights } => {
                let (p, features) = self.network.distribution_on_trunk(policy, &input)?;
                let layout = experience.sequences.layout;
                let width = experience.others.len() / layout.rows();
                let others = layout.columns(&experience.others, width, columns);
                Ok((p, Some(second.distribution(weights, &features, others)?)))
            }
        }
    }

    /// Clamps all sigmas to their floors; to be called after every optimiser step.
    pub(super) fn project(&self) -> Result<(), MarlError> {
        self.network.project()?;
        self.second_head.as_ref().map_or(Ok(()), SecondHead::project)
    }
}

#[cfg(test)]
mod tests {
    use policy::{Draw, PolicyConfig, Purpose, RunSeed};

    use super::super::agent::{fit_posteriors, gather};
    use super::super::ascent::{AgentInputs, gradient, maximise};
    use super::super::experience::Influence;
    use super::*;
    use crate::config::{QTraining, TrainingConfig};
    use crate::data::sequence::ChunkLayout;
    use crate::influence::mutual_information;
    use crate::optimisation::tests::meets_finite_differences;
    use crate::sample;
    use crate::state::saved;

    /// Two agents with their rollout data and influence.
    fn prepared(q_training: QTraining) -> (Vec<Agent>, Vec<Experience>, Vec<Influence>) {
        let mut config = sample::config();
        config.influence.q_training = q_training;
        prepared_with(&config, &sample::policy())
    }

    fn prepared_with(
        config: &TrainingConfig,
        policy: &PolicyConfig,
    ) -> (Vec<Agent>, Vec<Experience>, Vec<Influence>) {
        let (problem, batch) = (sample::problem(), sample::batch());
        let agent = |index| Agent::new(config, policy, &problem, RunSeed(0), index).unwrap();
        let mut agents = vec![agent(0), agent(1)];
        let layout = ChunkLayout::of(&batch, policy.backpropagation_steps);
        let advantage: Vec<f64> = batch.reward.iter().map(|&r| f64::from(r)).collect();
        let advantages = vec![advantage.clone(), advantage];
        let experience = gather(&agents, &batch, layout, &advantages, (RunSeed(3), 0)).unwrap();
        let influence = fit_posteriors(&mut agents, &experience, RunSeed(0), 0).unwrap();
        (agents, experience, influence)
    }

    #[test]
    fn a_second_head_is_evaluated_on_all_rows_before_it_is_trained_on_them() {
        let (agents, experience, influence) = prepared(QTraining::Shared);
        let second = agents[0].second_head.as_ref().unwrap();
        let conditional = second.conditional(&experience[0].conditions()).unwrap();
        let rows: Vec<usize> = (0..experience[0].sequences.layout.rows()).collect();
        let log_q = conditional.log_prob(&experience[0].sequences.action, &rows);
        let expected = mutual_information(&log_q, &experience[0].log_prob);
        assert!(expected.is_some());
        assert_eq!(influence[0].mi_estimate, expected);
    }

    #[test]
    fn the_gradient_of_equation_10_reaches_both_heads_and_their_trunk() {
        // With a small gain and lambda, the slopes of the second head would be lost in rounding errors. Neither clipping
        // nor the cap has an effect.
        let mut config = sample::config();
        (config.influence.q_training, config.update.clip) = (QTraining::Shared, 10.0);
        (config.influence.lambda, config.influence.kappa) = (1.0, 1e6);
        let policy = PolicyConfig { head_gain: 1.0, ..sample::policy() };
        let (agents, experience, influence) = prepared_with(&config, &policy);
        let agent = &agents[0];
        let inputs = AgentInputs { experience: &experience[0], influence: &influence[0] };
        let factor = vec![1.0; experience[0].log_prob.len()];
        let columns: Vec<usize> = (0..experience[0].sequences.layout.chunks).collect();
        let loss = || gradient(agent, inputs, &factor, &columns).unwrap().0.loss;
        let found = gradient(agent, inputs, &factor, &columns).unwrap().1;
        let (mut used, mut all, mut heads) = (0, 0, 0);
        for span in agent.trainable.spans() {
            let elements = span.range.clone().step_by(1 + span.range.len() / 7);
            let of = (&agent.trainable.vars()[span.var], found.0[span.var].as_slice());
            let significant = meets_finite_differences(&loss, of, elements.clone(), (2e-3, 5e-3));
            let name = span.name.as_str();
            if ["head.weight", "second_head.joined.weight", "second_head.head.weight"]
                .contains(&name)
            {
                assert!(2 * significant > elements.len(), "{name}: {significant} have a slope");
                heads += 1;
            }
            (used, all) = (used + significant, all + elements.len());
        }
        assert!(heads == 3 && 2 * used > all, "{used} of {all} have a slope");
    }

    #[test]
    fn the_sweep_trains_a_second_head_but_no_posterior_trained_by_likelihood() {
        for (q_training, touched) in [(QTraining::Mle, false), (QTraining::Shared, true)] {
            let (mut agents, experience, influence) = prepared(q_training);
            let weights = |agent: &mut Agent| {
                saved("weights/", |visitor| agent.visit_posterior(0, visitor)).unwrap()
            };
            let before = weights(&mut agents[0]);
            let factor = vec![1.0; experience[0].log_prob.len()];
            let key = (RunSeed(0), Draw::of(Purpose::Minibatch));
            let inputs = AgentInputs { experience: &experience[0], influence: &influence[0] };
            maximise(&mut agents[0], inputs, &factor, key).unwrap();
            assert_eq!(weights(&mut agents[0]) != before, touched);
        }
    }
}
