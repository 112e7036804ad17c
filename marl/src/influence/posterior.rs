//! The variational posterior `q_xi(a^i | a^-i, o^i, h^i)`: the second head of the paper's network.

use std::ops::Range;

use candle_core::{Device, Tensor, Var};
use policy::arrays::NamedArrays;
use policy::layers::LayerSpec;
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
use crate::layers::{TANH_GAIN, rows};
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
mod tests {
    use candle_core::DType;
    use policy::randomness::standard_normal;
    use policy::{CoreKind, RefreshHidden};

    use super::*;
    use crate::config::{CountedState, Divergence, Estimator, QTraining};
    use crate::gaussian;
    use crate::influence::mutual_information;

    const ROWS: usize = 20_000;
    const SIGMA: f64 = 0.3;

    fn config() -> InfluenceConfig {
        InfluenceConfig {
            lambda: 0.01,
            estimator: Estimator::VariationalKl,
            divergence: Divergence::KlQp,
            q_training: QTraining::Mle,
            kappa: 1.0,
            encoder: 16,
            hidden: 16,
            epochs: 10,
            learning_rate: 2e-2,
            minibatches: 20,
            sigma_floor: 0.05,
            holdout_every: 5,
            lag: 0,
            counted_state: CountedState::Observation,
        }
    }

    fn policy() -> PolicyConfig {
        PolicyConfig {
            core: CoreKind::Gru,
            encoder: 8,
            hidden: 8,
            width: 8,
            layers: 1,
            chunk_steps: 10,
            burn_in: 0,
            refresh_hidden: RefreshHidden::Never,
            initial_log_std: 1.0,
            sigma_scale: 0.5,
            sigma_floor: 0.05,
            head_gain: 0.01,
        }
    }

    fn posterior() -> Posterior {
        let kind = ActionKind::Continuous;
        of_shape(PosteriorShape { others: 1, features: 2, action: 1, kind })
    }

    fn of_shape(shape: PosteriorShape) -> Posterior {
        let adam = AdamConfig { learning_rate: 2e-2, epsilon: 1e-5, max_gradient_norm: 10.0 };
        Posterior::new(&config(), &policy(), adam, shape, (RunSeed(3), Precision::Single, 0))
            .unwrap()
    }

    /// Own and other actions, both normal with deviation `SIGMA` and correlation `rho`.
    fn actions(rho: f64) -> (Vec<f64>, Vec<f32>) {
        let mut rng = generator(RunSeed(5), Draw::of(Purpose::Probe));
        let mut normal = || f64::from(standard_normal(&mut rng));
        let pair = |_| {
            let (x, y) = (normal(), normal());
            (SIGMA * (rho * x + libm::sqrt(1.0 - rho * rho) * y), (SIGMA * x) as f32)
        };
        (0..ROWS).map(pair).unzip()
    }

    /// Trains on four rows of five; the mean gain in log-density over the marginal on the fifth.
    fn estimate(rho: f64) -> f64 {
        let (action, others) = actions(rho);
        let features = Tensor::ones((ROWS, 2), DType::F32, &Device::Cpu).unwrap();
        let data = Conditions { features: &features, others: &others, action: &action };
        let (held_out, trained): (Vec<usize>, Vec<usize>) = (0..ROWS).partition(|row| row % 5 == 4);
        let mut posterior = posterior();
        let draw = Draw::of(Purpose::PosteriorMinibatch);
        posterior.fit(&data, &trained, (RunSeed(3), draw)).unwrap();
        let log_q = posterior.conditional(&data).unwrap().log_prob(&action, &held_out);
        let marginal = |&row: &usize| gaussian::log_prob(&[action[row]], &[0.0], &[SIGMA]);
        let log_p: Vec<f64> = held_out.iter().map(marginal).collect();
        mutual_information(&log_q, &log_p).unwrap()
    }

    #[test]
    fn independent_actions_have_no_information_about_each_other() {
        assert!(estimate(0.0).abs() < 0.02, "{}", estimate(0.0));
    }

    #[test]
    fn the_information_of_correlated_actions_is_found_to_a_twentieth_of_a_nat() {
        // I = -1/2 log(1 - rho^2).
        for (rho, truth) in [(0.5, 0.143_841), (0.8, 0.510_826)] {
            let found = estimate(rho);
            assert!((found - truth).abs() < 0.05, "rho {rho}: {found}, truth {truth}");
        }
    }

    #[test]
    fn the_information_of_choices_that_mostly_agree_is_found_to_a_fiftieth_of_a_nat() {
        // The other's choice is even; the own one is the same with probability 0.8, else either of the rest.
        let mut rng = generator(RunSeed(6), Draw::of(Purpose::Probe));
        let kind = ActionKind::Discrete { choices: 3 };
        let (mut action, mut others) = (Vec::new(), Vec::new());
        for row in 0..ROWS {
            let chance = policy::categorical::draw(
                &[libm::logf(0.8), libm::logf(0.1), libm::logf(0.1)],
                &mut rng,
            );
            action.push(((row + chance) % 3) as f64);
            kind.see(&[(row % 3) as f32], &mut others);
        }
        let features = Tensor::ones((ROWS, 2), DType::F32, &Device::Cpu).unwrap();
        let data = Conditions { features: &features, others: &others, action: &action };
        let (held_out, trained): (Vec<usize>, Vec<usize>) = (0..ROWS).partition(|row| row % 5 == 4);
        let mut posterior = of_shape(PosteriorShape { others: 3, features: 2, action: 1, kind });
        let draw = Draw::of(Purpose::PosteriorMinibatch);
        posterior.fit(&data, &trained, (RunSeed(3), draw)).unwrap();
        let log_q = posterior.conditional(&data).unwrap().log_prob(&action, &held_out);
        let log_p = vec![-libm::log(3.0); held_out.len()];
        let found = mutual_information(&log_q, &log_p).unwrap();
        let truth = libm::log(3.0) + 0.8 * libm::log(0.8) + 0.2 * libm::log(0.1);
        assert!((found - truth).abs() < 0.02, "{found}, truth {truth}");
    }

    #[test]
    fn a_restored_posterior_goes_on_as_the_one_that_was_kept() {
        let (action, others) = actions(0.8);
        let features = Tensor::ones((ROWS, 2), DType::F32, &Device::Cpu).unwrap();
        let data = Conditions { features: &features, others: &others, action: &action };
        let all: Vec<usize> = (0..ROWS).collect();
        let fit = |posterior: &mut Posterior, iteration| {
            let draw = Draw::of(Purpose::PosteriorMinibatch).iteration(iteration);
            posterior.fit(&data, &all, (RunSeed(3), draw)).unwrap();
        };
        let (mut kept, mut other) = (posterior(), posterior());
        fit(&mut kept, 0);
        other.restore(0, &kept.arrays(0).unwrap()).unwrap();
        fit(&mut kept, 1);
        fit(&mut other, 1);
        assert_eq!(kept.arrays(0).unwrap(), other.arrays(0).unwrap());
    }
}
