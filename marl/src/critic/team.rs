//! The critics of an algorithm: one of the global state, or, as in independent PPO, one per agent of its observation.

use policy::RunSeed;
use rayon::prelude::*;

use super::{Critic, CriticFigures, ValueInputs, Values};
use crate::config::{Config, CriticInput};
use crate::data::batch::{AgentShape, Batch, Final, Problem};
use crate::error::MarlError;
use crate::state::Visitor;

/// One critic, or one per agent.
pub(crate) struct Critics {
    input: CriticInput,
    critics: Vec<Critic>,
}

impl Critics {
    /// Critics for `problem`, with weights initialised by `seed`. `chunk_steps` are the steps of truncated
    /// back-propagation.
    pub(crate) fn new(
        config: &Config,
        chunk_steps: usize,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let (own, actors) = (&config.critic, (config.update.adam_epsilon, chunk_steps));
        let critics = match own.input {
            CriticInput::State => {
                let sizes = (problem.state, config.critic_mode().values(problem.agents.len()));
                vec![Critic::new(own, actors, ("", 0), sizes, seed)?]
            }
            CriticInput::Observation => {
                let one = |(index, agent): (usize, &AgentShape)| {
                    let suffix = format!("_{index}");
                    let number = (suffix.as_str(), index as u32);
                    Critic::new(own, actors, number, (agent.observation, 1), seed)
                };
                problem.agents.iter().enumerate().map(one).collect::<Result<_, _>>()?
            }
        };
        Ok(Self { input: own.input, critics })
    }

    /// Sets the fraction of the configured learning rate for the next steps.
    pub(crate) fn scale_learning_rate(&mut self, share: f64) {
        self.critics.iter_mut().for_each(|critic| critic.scale_learning_rate(share));
    }

    /// Every critic's values of `batch`.
    pub(crate) fn values(&self, batch: &Batch) -> Result<Vec<Values>, MarlError> {
        let one = |(index, critic): (usize, &Critic)| {
            critic.values(batch, &self.input.inputs(batch, index))
        };
        self.critics.par_iter().enumerate().map(one).collect()
    }

    /// Keeps the recurrent states in which the rollout of `values` ended for the next rollout.
    pub(crate) fn carry(&mut self, values: &[Values]) {
        self.critics.iter_mut().zip(values).for_each(|(critic, values)| critic.carry(values));
    }

    /// Trains on the returns `[V][T, B]`; `values` are those before the fit.
    pub(crate) fn fit(
        &mut self,
        batch: &Batch,
        values: &[Values],
        returns: &[Vec<f64>],
        iteration: u64,
    ) -> Result<CriticFigures, MarlError> {
        let (input, count) = (self.input, self.critics.len());
        let own = returns.par_chunks(returns.len() / count);
        let one =
            |(index, ((critic, values), returns)): (usize, ((&mut Critic, &Values), &[_]))| {
                critic.fit(&input.inputs(batch, index), values, returns, iteration)
            };
        let fitted = self.critics.par_iter_mut().zip(values).zip(own).enumerate().map(one);
        let fitted = fitted.collect::<Result<Vec<CriticFigures>, MarlError>>()?;
        Ok(CriticFigures::mean(&fitted))
    }

    pub(crate) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.critics.iter_mut().try_for_each(|critic| critic.visit(visitor))
    }
}

impl CriticInput {
    /// Input of critic `index`.
    fn inputs(self, batch: &Batch, index: usize) -> ValueInputs<'_> {
        let own = |last: &Final| match self {
            Self::State => last.state.clone(),
            Self::Observation => last.observation[index].clone(),
        };
        let rows = match self {
            Self::State => &batch.state,
            Self::Observation => &batch.agents[index].observation,
        };
        ValueInputs { rows, finals: batch.finals.iter().flat_map(own).collect() }
    }
}

impl CriticFigures {
    /// Means over critics; numbers of skipped steps are summed.
    fn mean(critics: &[Self]) -> Self {
        let count = critics.len() as f64;
        let mean = |of: fn(&Self) -> f64| critics.iter().map(of).sum::<f64>() / count;
        Self {
            loss: mean(|one| one.loss),
            gradient_norm: mean(|one| one.gradient_norm),
            explained_variance: mean(|one| one.explained_variance),
            skipped: critics.iter().map(|one| one.skipped).sum(),
        }
    }
}
