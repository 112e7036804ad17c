//! The variational posterior `q_xi(a^i | a^-i, o^i, h^i)`: the policy with a correction that knows the others' actions.

use std::ops::Range;

use candle_core::{Device, Tensor, Var};
use policy::Precision;
use policy::arrays::NamedArrays;
use policy::layers::{LayerSpec, TANH_GAIN};
use policy::ops::{Activation, LayerStack, Weights, sigmoid};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};

use crate::config::InfluenceConfig;
use crate::data::batch::ActionKind;
use crate::distribution::HeadRows;
use crate::error::MarlError;
use crate::optimisation::gradient::{Gradients, OutputGradient, numbers, root};
use crate::optimisation::layers::rows;
use crate::optimisation::minibatch::minibatches;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::optimisation::shards::{self, shards};

/// Sizes around one agent's posterior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PosteriorShape {
    /// Numbers in the other agents' joint action `a^-i`, choices one-hot.
    pub others: usize,
    /// Features of the trunk.
    pub features: usize,
    /// Numbers in the own action.
    pub action: usize,
    /// What these numbers are.
    pub kind: ActionKind,
}

/// A distribution over the own action of the policy's kind, the behaviour policy plus a correction: `a^-i` encoded
/// (Linear, tanh) and joined with the trunk's features, then Linear, tanh, and Linear, which starts at 0, for what is
/// added to the logits or the mean. A Gaussian's sigma is the policy's times `2 sigmoid(c)` with a parameter `c` that
/// starts at 0. So an untrained posterior is the policy, and every estimate of it is exactly 0.
pub struct Posterior {
    config: InfluenceConfig,
    precision: Precision,
    shape: PosteriorShape,
    parameters: Parameters,
    /// Of the other agents' actions.
    encoder: LayerStack,
    /// Of features and encoded actions.
    joined: LayerStack,
    /// `c`, `[act]`; of a Gaussian alone.
    sigma_correction: Option<Var>,
    adam: Adam,
}

/// What a posterior learns from and is asked about, rows in any one order.
pub struct Conditions<'a> {
    /// The trunk's features under the behaviour weights, `[R, F]`; a constant.
    pub features: &'a Tensor,
    /// The other agents' actions, choices one-hot, `[R, others]`.
    pub others: &'a [f32],
    /// The own actions taken, `[R, act]`.
    pub action: &'a [f64],
    /// The behaviour policy of every row.
    pub policy: &'a HeadRows,
}

/// What a posterior makes of the policy in some rows.
struct Corrected {
    /// Added to the policy's means or logits, `[R, out]`.
    shift: Tensor,
    /// By which the policy's sigma is multiplied, `[act]`; of a Gaussian alone.
    factor: Option<Tensor>,
    /// The policy of these rows.
    policy: HeadRows,
    /// The posterior of these rows.
    posterior: HeadRows,
}

impl Corrected {
    fn of(shift: Tensor, factor: Option<Tensor>, policy: HeadRows) -> Result<Self, MarlError> {
        let by = factor.as_ref().map(numbers).transpose()?.unwrap_or_default();
        let posterior = policy.corrected(&numbers(&shift)?, &by);
        Ok(Self { shift, factor, policy, posterior })
    }

    /// A scalar with the given gradient by the posterior's numbers.
    fn root(&self, gradient: HeadRows) -> Result<Tensor, MarlError> {
        let (by_shift, by_factor) = self.policy.correction_gradient(gradient);
        let mut outputs = vec![OutputGradient { output: &self.shift, gradient: &by_shift }];
        outputs.extend(
            self.factor.iter().map(|output| OutputGradient { output, gradient: &by_factor }),
        );
        root(&outputs)
    }
}

impl Posterior {
    /// A posterior of this shape for agent `agent`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn new(
        config: &InfluenceConfig,
        adam_config: AdamConfig,
        shape: PosteriorShape,
        (seed, precision, agent): (RunSeed, Precision, u32),
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::PosteriorInitialisation).agent(agent));
        let (mut parameters, dtype) = (Parameters::new(), precision.dtype());
        let (others, joined) = (config.encoder, shape.features + config.encoder);
        let tanh = Activation::Tanh;
        let outputs = shape.kind.head().outputs(shape.action);
        let encoder = [LayerSpec::linear("encoder", (shape.others, others), tanh, TANH_GAIN)];
        let joined = [
            LayerSpec::linear("joined", (joined, config.hidden), tanh, TANH_GAIN),
            LayerSpec::linear("head", (config.hidden, outputs), Activation::Identity, 0.0),
        ];
        let encoder = LayerStack::declare(&mut parameters, &encoder, dtype, &mut rng)?;
        let joined = LayerStack::declare(&mut parameters, &joined, dtype, &mut rng)?;
        let sigma_correction = match shape.kind {
            ActionKind::Continuous => {
                let start = Tensor::zeros(shape.action, dtype, &Device::Cpu)?;
                Some(parameters.add("sigma_correction", start)?)
            }
            ActionKind::Discrete { .. } => None,
        };
        let (config, adam) = (config.clone(), Adam::new(adam_config, &parameters));
        Ok(Self { config, precision, shape, parameters, encoder, joined, sigma_correction, adam })
    }

    fn weights(&self) -> Result<[Weights; 2], MarlError> {
        Ok([self.encoder.weights()?, self.joined.weights()?])
    }

    /// The posterior of some rows. The features are constants here, so that nothing reaches the trunk through it.
    fn corrected(
        &self,
        [encoder, joined]: &[Weights; 2],
        data: &Conditions<'_>,
        part: &[usize],
    ) -> Result<Corrected, MarlError> {
        let width = self.shape.others;
        let index: Vec<u32> = part.iter().map(|&row| row as u32).collect();
        let index = Tensor::from_vec(index, part.len(), &Device::Cpu)?;
        let features = data.features.index_select(&index, 0)?.detach();
        let others = part.iter().flat_map(|&row| &data.others[row * width..(row + 1) * width]);
        let others = rows(others.copied().collect(), width, self.precision)?;
        let shift =
            joined.apply(&Tensor::cat(&[features, encoder.apply(&others, None)?], 1)?, None)?;
        let factor = self.sigma_correction.as_ref().map(|c| sigmoid(c.as_tensor())? * 2.0);
        Corrected::of(shift, factor.transpose()?, data.policy.of_rows(part))
    }

    /// Maximum likelihood on the rows `trained` of `data`: `max_xi mean log q_xi(a^i | a^-i, o^i, h^i)`, until an epoch
    /// no longer raises the likelihood of the rows `held_out`, or for all epochs if there are none. That last epoch is
    /// undone. Gives the mean log-likelihood of the last epoch that counts, nats, or what it was before if there is none.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn fit(
        &mut self,
        data: &Conditions<'_>,
        trained: &[usize],
        held_out: &[usize],
        (seed, draw): (RunSeed, Draw),
    ) -> Result<f64, MarlError> {
        let (mut reached, mut counted) = (self.log_likelihood(data, held_out)?, None);
        for epoch in 0..self.config.epochs {
            let before = self.parameters.to_arrays("")?;
            let (mut likelihood, draw) = (0.0, draw.step(epoch as u32));
            for part in minibatches(trained.len(), self.config.minibatches, seed, draw) {
                let part: Vec<usize> = part.into_iter().map(|place| trained[place]).collect();
                likelihood += self.step(data, &part)? * part.len() as f64 / trained.len() as f64;
            }
            let found = self.log_likelihood(data, held_out)?;
            if !held_out.is_empty() && found <= reached {
                self.parameters.load("", &before)?;
                break;
            }
            (reached, counted) = (found, Some(likelihood));
        }
        counted.map_or_else(|| self.log_likelihood(data, trained), Ok)
    }

    /// Mean `log q` of the actions in the rows `of`, nats; 0 of none.
    fn log_likelihood(&self, data: &Conditions<'_>, of: &[usize]) -> Result<f64, MarlError> {
        let width = self.shape.action;
        let action = of.iter().flat_map(|&row| &data.action[row * width..(row + 1) * width]);
        let action: Vec<f64> = action.copied().collect();
        let all: Vec<usize> = (0..of.len()).collect();
        let log_q = self.conditional(data, of)?.log_prob(&action, &all);
        Ok(log_q.iter().sum::<f64>() / of.len().max(1) as f64)
    }

    fn step(&mut self, data: &Conditions<'_>, part: &[usize]) -> Result<f64, MarlError> {
        let (weights, width) = (self.weights()?, self.shape.action);
        let share = 1.0 / part.len() as f64;
        let one = |range: Range<usize>| {
            let rows = &part[range];
            let corrected = self.corrected(&weights, data, rows)?;
            let q = &corrected.posterior;
            let (mut likelihood, mut gradient) = (0.0, q.zeros());
            for (place, &row) in rows.iter().enumerate() {
                let action = &data.action[row * width..(row + 1) * width];
                likelihood += share * q.log_prob_of(place, action);
                gradient.add_log_prob_gradient(-share, place, action, q);
            }
            Ok((likelihood, Gradients::of(&self.parameters, &corrected.root(gradient)?)?))
        };
        let (likelihood, gradients) = shards::sum(&shards(part.len(), 1), &one)?;
        self.descend(&gradients, data.policy)?;
        Ok(likelihood)
    }

    /// One optimiser step, after which sigma is at its floor or above: `influence.posterior_sigma_floor`, or the policy's sigma
    /// where that is lower.
    fn descend(&mut self, gradients: &Gradients, policy: &HeadRows) -> Result<(), MarlError> {
        self.adam.step(&self.parameters, gradients)?;
        let Some(correction) = &self.sigma_correction else {
            return Ok(());
        };
        let lowest = |sigma: &f64| {
            let half = (0.5 * self.config.posterior_sigma_floor / sigma).min(0.5);
            self.precision.round(libm::log(half / (1.0 - half)))
        };
        let held = numbers(correction.as_tensor())?.into_iter().zip(&policy.sigma);
        let held: Vec<f64> = held.map(|(c, sigma)| c.max(lowest(sigma))).collect();
        let held = Tensor::from_vec(held, policy.sigma.len(), &Device::Cpu)?;
        Ok(correction.set(&held.to_dtype(self.precision.dtype())?)?)
    }

    /// The posterior of the rows `of` of `data`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn conditional(&self, data: &Conditions<'_>, of: &[usize]) -> Result<HeadRows, MarlError> {
        let weights = [self.encoder.constant_weights()?, self.joined.constant_weights()?];
        let one = |range: Range<usize>| Ok(self.corrected(&weights, data, &of[range])?.posterior);
        let parts = shards::of_each(&shards(of.len(), 1), one)?;
        Ok(data.policy.joined(&parts))
    }

    /// Optimiser steps skipped so far because their gradient was not finite.
    #[must_use]
    pub fn skipped(&self) -> i64 {
        self.adam.skipped()
    }

    /// `weights/posterior_I.*` and `optimizer/posterior_I.*`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn arrays(&self, agent: usize) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.parameters.to_arrays(&format!("weights/posterior_{agent}."))?;
        arrays.append(&mut self.adam.arrays(&format!("optimizer/posterior_{agent}.")));
        Ok(arrays)
    }

    /// Takes over what [`Posterior::arrays`] gave.
    ///
    /// # Errors
    /// Names an array that is missing or does not fit.
    pub fn restore(&mut self, agent: usize, arrays: &NamedArrays) -> Result<(), MarlError> {
        self.parameters.load(&format!("weights/posterior_{agent}."), arrays)?;
        self.adam.restore(&format!("optimizer/posterior_{agent}."), arrays)
    }
}

#[cfg(test)]
mod tests;
