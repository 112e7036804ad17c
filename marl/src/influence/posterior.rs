//! The variational posterior `q_xi(a^i | a^-i, o^i, h^i)`: the second head of the paper's network.

use candle_core::{DType, Device, Tensor, Var};
use policy::PolicyConfig;
use policy::arrays::NamedArrays;
use policy::ops::{Activation, sigmoid};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};

use crate::config::InfluenceConfig;
use crate::error::MarlError;
use crate::gaussian;
use crate::gradient::{Gradients, OutputGradient, numbers, root};
use crate::influence::Term;
use crate::influence::divergence::add_gradient_by_posterior;
use crate::layers::{Builder, Dense, TANH_GAIN, rows};
use crate::minibatch::minibatches;
use crate::optimizer::{Adam, AdamConfig};

/// Sizes around one agent's posterior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PosteriorShape {
    /// Numbers in the other agents' joint action `a^-i`.
    pub others: usize,
    /// Features of the trunk.
    pub features: usize,
    /// Dimensions of the own action.
    pub action: usize,
}

/// A diagonal Gaussian over the own action: `a^-i` encoded (Linear, tanh) and joined with the trunk's
/// features, then Linear, tanh, and the mean; sigma as in the policy's head, a parameter of its own.
pub struct Posterior {
    config: InfluenceConfig,
    sigma_scale: f64,
    shape: PosteriorShape,
    parameters: Parameters,
    encoder: Dense,
    joined: Dense,
    head: Dense,
    log_std: Var,
    adam: Adam,
}

/// What a posterior learns from and is asked about, rows in any one order.
pub struct Conditions<'a> {
    /// The trunk's features under the behaviour weights, `[R, F]`; a constant.
    pub features: &'a Tensor,
    /// The other agents' actions, `[R, others]`.
    pub others: &'a [f32],
    /// The own actions taken, `[R, act]`.
    pub action: &'a [f64],
}

/// A posterior's answer for every row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Conditional {
    /// Means, `[R, act]`.
    pub mean: Vec<f64>,
    /// Deviations, `[act]`.
    pub sigma: Vec<f64>,
}

impl Conditional {
    /// `log q(a | a^-i, o, h)` of the actions `[R, act]`, for the given rows; nats.
    #[must_use]
    pub fn log_prob(&self, action: &[f64], of: &[usize]) -> Vec<f64> {
        let width = self.sigma.len();
        let row = |&row: &usize| {
            let of_row = row * width..(row + 1) * width;
            gaussian::log_prob(&action[of_row.clone()], &self.mean[of_row], &self.sigma)
        };
        of.iter().map(row).collect()
    }
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
        (seed, agent): (RunSeed, u32),
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::PosteriorInitialisation).agent(agent));
        let mut builder = Builder { parameters: Parameters::new(), rng: &mut rng };
        let (others, joined) = (config.encoder, shape.features + config.encoder);
        let (tanh, gain) = (Activation::Tanh, f64::from(policy.head_gain));
        let encoder = builder.dense("encoder", (shape.others, others), TANH_GAIN, tanh)?;
        let joined = builder.dense("joined", (joined, config.hidden), TANH_GAIN, tanh)?;
        let head =
            builder.dense("head", (config.hidden, shape.action), gain, Activation::Identity)?;
        let start = vec![policy.initial_log_std; shape.action];
        let log_std = builder.parameter("log_std", start, &[shape.action])?;
        let parameters = builder.parameters;
        let (config, adam) = (config.clone(), Adam::new(adam_config, &parameters));
        let sigma_scale = f64::from(policy.sigma_scale);
        Ok(Self { config, sigma_scale, shape, parameters, encoder, joined, head, log_std, adam })
    }

    /// Means `[R, act]` and deviations `[act]`.
    fn forward(&self, features: &Tensor, others: Vec<f32>) -> Result<(Tensor, Tensor), MarlError> {
        let encoded = self.encoder.apply(&rows(others, self.shape.others)?)?;
        let joined = Tensor::cat(&[features, &encoded], 1)?;
        let mean = self.head.apply(&self.joined.apply(&joined)?)?;
        Ok((mean, (sigmoid(self.log_std.as_tensor())? * self.sigma_scale)?))
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

    /// Means and deviations of some rows. The features are constants here, so that nothing reaches
    /// the trunk through the posterior.
    fn forward_rows(
        &self,
        data: &Conditions<'_>,
        part: &[usize],
    ) -> Result<(Tensor, Tensor), MarlError> {
        let others = self.shape.others;
        let index: Vec<u32> = part.iter().map(|&row| row as u32).collect();
        let index = Tensor::from_vec(index, part.len(), &Device::Cpu)?;
        let features = data.features.index_select(&index, 0)?.detach();
        let actions = part.iter().flat_map(|&row| &data.others[row * others..(row + 1) * others]);
        self.forward(&features, actions.copied().collect())
    }

    fn step(&mut self, data: &Conditions<'_>, part: &[usize]) -> Result<f64, MarlError> {
        let width = self.shape.action;
        let (mean, sigma) = self.forward_rows(data, part)?;
        let (means, sigmas) = (numbers(&mean)?, numbers(&sigma)?);
        let (mut d_mean, mut d_sigma) = (vec![0.0; means.len()], vec![0.0; width]);
        let (mut likelihood, share) = (0.0, 1.0 / part.len() as f64);
        for (place, &row) in part.iter().enumerate() {
            let (here, action) =
                (place * width..(place + 1) * width, row * width..(row + 1) * width);
            let q = (&means[here.clone()], sigmas.as_slice());
            let action = &data.action[action];
            likelihood += share * gaussian::log_prob(action, q.0, q.1);
            let gradient = (&mut d_mean[here], d_sigma.as_mut_slice());
            gaussian::add_log_prob_gradient(-share, action, q, gradient);
        }
        self.descend((&mean, &d_mean), (&sigma, &d_sigma))?;
        Ok(likelihood)
    }

    /// One optimiser step up `lambda` times the influence term of the rows `part`, the posterior's
    /// share of Eq. 10. The policy's mean `[part, act]` and sigma `[act]` are constants.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn climb(
        &mut self,
        data: &Conditions<'_>,
        part: &[usize],
        (p_mean, p_sigma): (&[f64], &[f64]),
        (lambda, term): (f64, Term),
    ) -> Result<(), MarlError> {
        let width = self.shape.action;
        let (mean, sigma) = self.forward_rows(data, part)?;
        let (means, sigmas) = (numbers(&mean)?, numbers(&sigma)?);
        let (mut d_mean, mut d_sigma) = (vec![0.0; means.len()], vec![0.0; width]);
        let weight = -lambda / part.len() as f64;
        for place in 0..part.len() {
            let here = place * width..(place + 1) * width;
            let (q, p) = ((&means[here.clone()], &sigmas[..]), (&p_mean[here.clone()], p_sigma));
            let (_, slope) = term.row(q, p);
            let gradient = (&mut d_mean[here], d_sigma.as_mut_slice());
            add_gradient_by_posterior(term.divergence, weight * slope, q, p, gradient);
        }
        self.descend((&mean, &d_mean), (&sigma, &d_sigma))
    }

    /// One optimiser step down the given gradients of the outputs.
    fn descend(
        &mut self,
        (mean, d_mean): (&Tensor, &[f64]),
        (sigma, d_sigma): (&Tensor, &[f64]),
    ) -> Result<(), MarlError> {
        let root = root(&[
            OutputGradient { output: mean, gradient: d_mean },
            OutputGradient { output: sigma, gradient: d_sigma },
        ])?;
        self.adam.step(&self.parameters, &Gradients::of(&self.parameters, &root)?)?;
        self.project()
    }

    /// Holds sigma at its floor, as the actors' networks do.
    fn project(&self) -> Result<(), MarlError> {
        let share = self.config.sigma_floor / self.sigma_scale;
        let lowest = libm::log(share / (1.0 - share)) as f32;
        let values = self.log_std.as_tensor().to_vec1::<f32>()?;
        if values.iter().any(|&value| value < lowest) {
            let held: Vec<f32> = values.into_iter().map(|value| value.max(lowest)).collect();
            let width = held.len();
            self.log_std
                .set(&Tensor::from_vec(held, width, &Device::Cpu)?.to_dtype(DType::F32)?)?;
        }
        Ok(())
    }

    /// The posterior of every row of `data`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn conditional(&self, data: &Conditions<'_>) -> Result<Conditional, MarlError> {
        let (mean, sigma) = self.forward(&data.features.detach(), data.others.to_vec())?;
        Ok(Conditional { mean: numbers(&mean)?, sigma: numbers(&sigma)? })
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
    use policy::CoreKind;
    use policy::randomness::standard_normal;

    use super::*;
    use crate::config::{Divergence, Estimator, QTraining};
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
            initial_log_std: 1.0,
            sigma_scale: 0.5,
            sigma_floor: 0.05,
            head_gain: 0.01,
        }
    }

    fn posterior() -> Posterior {
        let adam = AdamConfig { learning_rate: 2e-2, epsilon: 1e-5, max_gradient_norm: 10.0 };
        let shape = PosteriorShape { others: 1, features: 2, action: 1 };
        Posterior::new(&config(), &policy(), adam, shape, (RunSeed(3), 0)).unwrap()
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
