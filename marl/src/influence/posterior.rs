//! The variational posterior `q_xi(a^i | a^-i, o^i, h^i)`: the second head of the paper's network.

use std::ops::Range;

use candle_core::{Device, Tensor, Var};
use policy::arrays::NamedArrays;
use policy::layers::{LayerSpec, TANH_GAIN};
use policy::ops::{Activation, LayerStack, Weights, sigmoid};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{Categorical, Distribution, Gaussian, PolicyConfig, Precision};

use crate::batch::ActionKind;
use crate::config::InfluenceConfig;
use crate::error::MarlError;
use crate::gradient::{Gradients, numbers};
use crate::head_rows::HeadRows;
use crate::influence::Term;
use crate::layers::rows;
use crate::minibatch::minibatches;
use crate::optimizer::{Adam, AdamConfig};
use crate::shards::{self, shards};

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

/// A distribution over the own action of the policy's kind: `a^-i` encoded (Linear, tanh) and joined with the
/// trunk's features, then Linear, tanh, and the logits or the mean; sigma as in the policy's head, a parameter of
/// its own.
pub struct Posterior {
    config: InfluenceConfig,
    sigma_scale: f64,
    precision: Precision,
    shape: PosteriorShape,
    parameters: Parameters,
    /// Of the other agents' actions.
    encoder: LayerStack,
    /// Of features and encoded actions.
    joined: LayerStack,
    /// Of a Gaussian alone.
    log_std: Option<Var>,
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
}

impl Posterior {
    /// A posterior of this shape for agent `agent`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn new(
        config: &InfluenceConfig,
        policy: &PolicyConfig,
        adam_config: AdamConfig,
        shape: PosteriorShape,
        (seed, precision, agent): (RunSeed, Precision, u32),
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::PosteriorInitialisation).agent(agent));
        let (mut parameters, dtype) = (Parameters::new(), precision.dtype());
        let (others, joined) = (config.encoder, shape.features + config.encoder);
        let (tanh, gain) = (Activation::Tanh, f64::from(policy.head_gain));
        let outputs = shape.kind.head().outputs(shape.action);
        let encoder = [LayerSpec::linear("encoder", (shape.others, others), tanh, TANH_GAIN)];
        let joined = [
            LayerSpec::linear("joined", (joined, config.hidden), tanh, TANH_GAIN),
            LayerSpec::linear("head", (config.hidden, outputs), Activation::Identity, gain),
        ];
        let encoder = LayerStack::declare(&mut parameters, &encoder, dtype, &mut rng)?;
        let joined = LayerStack::declare(&mut parameters, &joined, dtype, &mut rng)?;
        let log_std = match shape.kind {
            ActionKind::Continuous => {
                let start = Tensor::full(policy.initial_log_std, shape.action, &Device::Cpu)?;
                Some(parameters.add("log_std", start.to_dtype(dtype)?)?)
            }
            ActionKind::Discrete { .. } => None,
        };
        let (config, adam) = (config.clone(), Adam::new(adam_config, &parameters));
        let sigma_scale = f64::from(policy.sigma_scale);
        Ok(Self {
            config,
            sigma_scale,
            precision,
            shape,
            parameters,
            encoder,
            joined,
            log_std,
            adam,
        })
    }

    fn weights(&self) -> Result<[Weights; 2], MarlError> {
        Ok([self.encoder.weights()?, self.joined.weights()?])
    }

    fn forward(
        &self,
        [encoder, joined]: &[Weights; 2],
        features: &Tensor,
        others: Vec<f32>,
    ) -> Result<Distribution, MarlError> {
        let encoded = encoder.apply(&rows(others, self.shape.others, self.precision)?, None)?;
        let output = joined.apply(&Tensor::cat(&[features, &encoded], 1)?, None)?;
        let Some(log_std) = &self.log_std else {
            return Ok(Distribution::Categorical(Categorical { logits: output }));
        };
        let sigma = (sigmoid(log_std.as_tensor())? * self.sigma_scale)?;
        Ok(Distribution::Gaussian(Gaussian { mean: output, sigma }))
    }

    /// Maximum likelihood on the rows `trained` of `data`: `max_xi mean log q_xi(a^i | a^-i, o^i, h^i)`.
    /// Gives the mean log-likelihood of the last epoch, nats. The features are constants, so nothing
    /// of it reaches the trunk.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn fit(
        &mut self,
        data: &Conditions<'_>,
        trained: &[usize],
        (seed, draw): (RunSeed, Draw),
    ) -> Result<f64, MarlError> {
        let mut likelihood = 0.0;
        for epoch in 0..self.config.epochs {
            likelihood = 0.0;
            let draw = draw.step(epoch as u32);
            for part in minibatches(trained.len(), self.config.minibatches, seed, draw) {
                let part: Vec<usize> = part.into_iter().map(|place| trained[place]).collect();
                likelihood += self.step(data, &part)? * part.len() as f64 / trained.len() as f64;
            }
        }
        Ok(likelihood)
    }

    /// What the head says of some rows. The features are constants here, so that nothing reaches
    /// the trunk through the posterior.
    fn forward_rows(
        &self,
        weights: &[Weights; 2],
        data: &Conditions<'_>,
        part: &[usize],
    ) -> Result<Distribution, MarlError> {
        let others = self.shape.others;
        let index: Vec<u32> = part.iter().map(|&row| row as u32).collect();
        let index = Tensor::from_vec(index, part.len(), &Device::Cpu)?;
        let features = data.features.index_select(&index, 0)?.detach();
        let actions = part.iter().flat_map(|&row| &data.others[row * others..(row + 1) * others]);
        self.forward(weights, &features, actions.copied().collect())
    }

    fn step(&mut self, data: &Conditions<'_>, part: &[usize]) -> Result<f64, MarlError> {
        let (weights, width) = (self.weights()?, self.shape.action);
        let share = 1.0 / part.len() as f64;
        let one = |range: Range<usize>| {
            let rows = &part[range];
            let head = self.forward_rows(&weights, data, rows)?;
            let q = HeadRows::of(&head)?;
            let (mut likelihood, mut gradient) = (0.0, q.zeros());
            for (place, &row) in rows.iter().enumerate() {
                let action = &data.action[row * width..(row + 1) * width];
                likelihood += share * q.log_prob_of(place, action);
                gradient.add_log_prob_gradient(-share, place, action, &q);
            }
            Ok((likelihood, Gradients::of(&self.parameters, &gradient.root(&head)?)?))
        };
        let (likelihood, gradients) = shards::sum(&shards(part.len(), 1), &one)?;
        self.descend(&gradients)?;
        Ok(likelihood)
    }

    /// One optimiser step up `lambda` times the influence term of the rows `part`, the posterior's
    /// share of Eq. 10. The policy `p` of these rows is a constant.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn climb(
        &mut self,
        data: &Conditions<'_>,
        part: &[usize],
        p: &HeadRows,
        (lambda, term): (f64, Term),
    ) -> Result<(), MarlError> {
        let head = self.forward_rows(&self.weights()?, data, part)?;
        let q = HeadRows::of(&head)?;
        let weight = -lambda / part.len() as f64;
        let root = q.influence_gradient(weight, p, term).root(&head)?;
        self.descend(&Gradients::of(&self.parameters, &root)?)
    }

    /// One optimiser step.
    fn descend(&mut self, gradients: &Gradients) -> Result<(), MarlError> {
        self.adam.step(&self.parameters, gradients)?;
        self.project()
    }

    /// Holds sigma at its floor, as the actors' networks do.
    fn project(&self) -> Result<(), MarlError> {
        let Some(log_std) = &self.log_std else { return Ok(()) };
        let share = self.config.sigma_floor / self.sigma_scale;
        let lowest = self.precision.round(libm::log(share / (1.0 - share)));
        let values = numbers(log_std.as_tensor())?;
        if values.iter().any(|&value| value < lowest) {
            let held: Vec<f64> = values.into_iter().map(|value| value.max(lowest)).collect();
            let width = held.len();
            let held = Tensor::from_vec(held, width, &Device::Cpu)?;
            log_std.set(&held.to_dtype(self.precision.dtype())?)?;
        }
        Ok(())
    }

    /// The posterior of every row of `data`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn conditional(&self, data: &Conditions<'_>) -> Result<HeadRows, MarlError> {
        let (features, others) = (data.features.detach(), data.others.to_vec());
        let weights = [self.encoder.constant_weights()?, self.joined.constant_weights()?];
        HeadRows::of(&self.forward(&weights, &features, others)?)
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
