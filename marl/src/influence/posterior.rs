//! The variational posterior `q_xi(a^i | a^-i, o^i, h^i)`: the policy plus a correction that depends on the others'
//! actions.

use std::ops::Range;

use candle_core::{DType, Device, Tensor, Var};
use policy::layers::{LayerSpec, TANH_GAIN};
use policy::ops::{Activation, LayerStack, Weights, sigmoid};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use rand::RngCore;

use crate::config::InfluenceConfig;
use crate::data::batch::ActionKind;
use crate::distribution::HeadRows;
use crate::error::MarlError;
use crate::optimisation::gradient::{Gradients, OutputGradient, numbers, root};
use crate::optimisation::layers::rows;
use crate::optimisation::minibatch::minibatches;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::optimisation::shards::{self, shards};
use crate::rounding::round;
use crate::shape::assert_shape;
use crate::state::{Visitor, visit_parameters};

/// Sizes of one agent's posterior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PosteriorShape {
    /// Size of the other agents' joint action `a^-i`, choices one-hot.
    pub others: usize,
    /// Number of trunk features.
    pub features: usize,
    /// Size of the agent's action.
    pub action: usize,
    /// Kind of action.
    pub kind: ActionKind,
}

/// A distribution of the policy's kind: the behaviour policy plus a correction. `a^-i` is encoded (Linear, tanh) and
/// joined with the trunk's features; Linear, tanh and a Linear that starts at 0 give the shift of the logits or the
/// mean. A Gaussian's sigma is the policy's times `2 sigmoid(c)`, with a parameter `c` that starts at 0. An untrained
/// posterior is therefore the policy with independent noise, and without shared noise every estimate from it is exactly 0.
pub(crate) struct Posterior {
    config: InfluenceConfig,
    shape: PosteriorShape,
    parameters: Parameters,
    /// Input: the other agents' actions.
    encoder: LayerStack,
    /// Input: features and encoded actions.
    joined: LayerStack,
    /// `c`, `[act]`; only for Gaussians.
    sigma_correction: Option<Var>,
    adam: Adam,
}

/// Training data and queries of a posterior, rows in any order.
pub(crate) struct Conditions<'a> {
    /// The trunk's features under the behaviour weights, `[R, F]`; constant.
    pub features: &'a Tensor,
    /// The other agents' actions, choices one-hot, `[R, others]`.
    pub others: &'a [f32],
    /// The agent's actions, `[R, act]`.
    pub action: &'a [f64],
    /// The behaviour policy of every row.
    pub policy: &'a HeadRows,
}

impl Conditions<'_> {
    /// Checks that all arrays have the rows of the policy and the sizes of the posterior.
    ///
    /// # Panics
    /// If one has another shape.
    #[track_caller]
    fn assert_shapes(&self, posterior: PosteriorShape) {
        let (rows, PosteriorShape { others, features, action, .. }) =
            (self.policy.count(), posterior);
        assert_shape("features", self.features.dims(), &[rows, features]);
        assert_shape("the others' actions", self.others.len(), rows * others);
        assert_shape("actions", self.action.len(), rows * action);
    }
}

/// The posterior of some rows with its correction.
struct Corrected {
    /// Shift of the policy's means or logits, `[R, out]`.
    shift: Tensor,
    /// Factor of the policy's sigma, `[act]`; only for Gaussians.
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

    /// A scalar with the given gradient with respect to the parameters of the posterior distributions.
    fn root(&self, gradient: HeadRows) -> Result<Tensor, MarlError> {
        let (by_shift, by_factor) = self.policy.correction_gradient(gradient);
        let mut outputs = vec![OutputGradient { output: &self.shift, gradient: &by_shift }];
        outputs.extend(
            self.factor.iter().map(|output| OutputGradient { output, gradient: &by_factor }),
        );
        root(&outputs)
    }
}

/// The two stacks of layers of q, with initial weights: the encoder of the other agents' actions, and the layers over the
/// features joined with its output, which end in `outputs` linear units with the orthogonal gain `gain`.
///
/// # Errors
/// If a tensor operation fails.
pub(super) fn stacks(
    config: &InfluenceConfig,
    shape: PosteriorShape,
    (outputs, gain): (usize, f64),
    parameters: &mut Parameters,
    rng: &mut impl RngCore,
) -> Result<[LayerStack; 2], MarlError> {
    let tanh = Activation::Tanh;
    let encoder = (shape.others, config.encoder);
    let joined = (shape.features + config.encoder, config.hidden);
    let encoder = [LayerSpec::linear("encoder", encoder, tanh, TANH_GAIN)];
    let joined = [
        LayerSpec::linear("joined", joined, tanh, TANH_GAIN),
        LayerSpec::linear("head", (config.hidden, outputs), Activation::Identity, gain),
    ];
    let encoder = LayerStack::declare(parameters, &encoder, rng)?;
    Ok([encoder, LayerStack::declare(parameters, &joined, rng)?])
}

impl Posterior {
    /// A posterior of this shape for agent `agent`, with initial weights.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn new(
        config: &InfluenceConfig,
        adam_config: AdamConfig,
        shape: PosteriorShape,
        (seed, agent): (RunSeed, u32),
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::PosteriorInitialisation).agent(agent));
        let mut parameters = Parameters::new();
        let head = (shape.kind.head().outputs(shape.action), 0.0);
        let [encoder, joined] = stacks(config, shape, head, &mut parameters, &mut rng)?;
        let sigma_correction = match shape.kind {
            ActionKind::Continuous => {
                let start = Tensor::zeros(shape.action, DType::F32, &Device::Cpu)?;
                Some(parameters.add("sigma_correction", start)?)
            }
            ActionKind::Discrete { .. } => None,
        };
        let config = config.clone();
        let adam = Adam::new(adam_config, &parameters);
        Ok(Self { config, shape, parameters, encoder, joined, sigma_correction, adam })
    }

    fn weights(&self) -> Result<[Weights; 2], MarlError> {
        Ok([self.encoder.weights()?, self.joined.weights()?])
    }

    /// The posterior of some rows. The features are constant, so that no gradient reaches the trunk.
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
        let others = rows(others.copied().collect(), width)?;
        let shift =
            joined.apply(&Tensor::cat(&[features, encoder.apply(&others, None)?], 1)?, None)?;
        let factor = self.sigma_correction.as_ref().map(|c| sigmoid(c.as_tensor())? * 2.0);
        Corrected::of(shift, factor.transpose()?, data.policy.of_rows(part))
    }

    /// Maximum likelihood on the rows `trained` of `data`: `max_xi mean log q_xi(a^i | a^-i, o^i, h^i)`. Training ends
    /// after an epoch that does not raise the likelihood of the rows `held_out`, which is undone, or, without such
    /// rows, after all epochs. Returns the mean log-likelihood of the last epoch that was kept, nats; before any, the
    /// initial one.
    ///
    /// # Errors
    /// If a tensor operation fails.
    ///
    /// # Panics
    /// If an array of `data` has another shape than the posterior's.
    pub(crate) fn fit(
        &mut self,
        data: &Conditions<'_>,
        trained: &[usize],
        held_out: &[usize],
        (seed, draw): (RunSeed, Draw),
    ) -> Result<f64, MarlError> {
        data.assert_shapes(self.shape);
        let mut reached = self.log_likelihood(data, held_out)?;
        let mut counted = None;
        for epoch in 0..self.config.epochs {
            let before = self.parameters.values()?;
            let mut likelihood = 0.0;
            let draw = draw.step(epoch as u32);
            for part in minibatches(trained.len(), self.config.minibatches, seed, draw) {
                let part: Vec<usize> = part.into_iter().map(|place| trained[place]).collect();
                likelihood += self.step(data, &part)? * part.len() as f64 / trained.len() as f64;
            }
            let found = self.log_likelihood(data, held_out)?;
            if !held_out.is_empty() && found <= reached {
                self.parameters.set(before)?;
                break;
            }
            (reached, counted) = (found, Some(likelihood));
        }
        counted.map_or_else(|| self.log_likelihood(data, trained), Ok)
    }

    /// Mean `log q` of the actions in the rows `of`, nats; 0 without rows.
    fn log_likelihood(&self, data: &Conditions<'_>, of: &[usize]) -> Result<f64, MarlError> {
        let width = self.shape.action;
        let action = of.iter().flat_map(|&row| &data.action[row * width..(row + 1) * width]);
        let action: Vec<f64> = action.copied().collect();
        let all: Vec<usize> = (0..of.len()).collect();
        let log_q = self.conditional(data, of)?.log_prob(&action, &all);
        Ok(log_q.iter().sum::<f64>() / of.len().max(1) as f64)
    }

    fn step(&mut self, data: &Conditions<'_>, part: &[usize]) -> Result<f64, MarlError> {
        let weights = self.weights()?;
        let width = self.shape.action;
        let share = 1.0 / part.len() as f64;
        let one = |range: Range<usize>| {
            let rows = &part[range];
            let corrected = self.corrected(&weights, data, rows)?;
            let q = &corrected.posterior;
            let mut likelihood = 0.0;
            let mut gradient = q.zeros();
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

    /// One optimiser step, after which sigma is clamped to at least its floor: `influence.posterior_sigma_floor`, or
    /// the policy's sigma if that is lower.
    fn descend(&mut self, gradients: &Gradients, policy: &HeadRows) -> Result<(), MarlError> {
        self.adam.step(&self.parameters, gradients)?;
        let Some(correction) = &self.sigma_correction else {
            return Ok(());
        };
        let lowest = |sigma: &f64| {
            let half = (0.5 * self.config.posterior_sigma_floor / sigma).min(0.5);
            round(libm::log(half / (1.0 - half)))
        };
        let held = numbers(correction.as_tensor())?.into_iter().zip(&policy.sigma);
        let held = held.map(|(c, sigma)| c.max(lowest(sigma)) as f32);
        Ok(correction.set(&Tensor::from_iter(held, &Device::Cpu)?)?)
    }

    /// The posterior of the rows `of` of `data`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    ///
    /// # Panics
    /// If an array of `data` has another shape than the posterior's.
    pub(crate) fn conditional(
        &self,
        data: &Conditions<'_>,
        of: &[usize],
    ) -> Result<HeadRows, MarlError> {
        data.assert_shapes(self.shape);
        let weights = [self.encoder.constant_weights()?, self.joined.constant_weights()?];
        let one = |range: Range<usize>| Ok(self.corrected(&weights, data, &of[range])?.posterior);
        let parts = shards::of_each(&shards(of.len(), 1), one)?;
        Ok(data.policy.joined(&parts))
    }

    /// Number of optimiser steps skipped because their gradient was not finite.
    pub(crate) fn skipped(&self) -> i64 {
        self.adam.skipped()
    }

    /// Visits `weights/posterior_I.*` and `optimizer/posterior_I.*`.
    pub(crate) fn visit(
        &mut self,
        agent: usize,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        visit_parameters(visitor, &format!("weights/posterior_{agent}."), &self.parameters)?;
        self.adam.visit(&format!("optimizer/posterior_{agent}."), visitor)
    }
}

#[cfg(test)]
mod tests;
