//! A variational autoencoder over the standardised features. Its evidence lower bound replaces the log-density. Its
//! training continues from iteration to iteration.

use candle_core::{Device, Tensor, Var};
use libm::{exp, log};
use policy::layers::{LayerSpec, TANH_GAIN};
use policy::ops::{Activation, Backward, LayerStack};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

use super::moments::Moments;
use crate::density::{Density, DensityContext, Observations};
use crate::distribution::gaussian::LOG_TWO_PI;
use crate::error::MarlError;
use crate::optimisation::gradient::{Gradients, OutputGradient, by, numbers, root};
use crate::optimisation::layers::rows;
use crate::optimisation::minibatch::minibatches;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::state::{Visitor, visit_parameters};

/// Gain of the decoder's output. Its means differ from the start, so that the latent is useful.
const DECODER_GAIN: f64 = 1.0;
/// Gain of the encoder's output. The initial latent is nearly the prior.
const ENCODER_GAIN: f64 = 0.01;
/// Logarithm of the decoder's initial standard deviations, in units of the features'. At a standard deviation of 1,
/// ignoring the latent would be a local optimum that is hard to leave.
const START_LOG_SIGMA: f32 = -1.0;
/// Adam's epsilon, as in Kingma and Ba.
const EPSILON: f64 = 1e-8;
/// The actors' limit, which gradients rarely reach.
const MAX_GRADIENT_NORM: f64 = 10.0;

/// Sizes and training.
#[derive(Clone, Copy, Debug)]
pub(super) struct VaeConfig {
    /// Units of the hidden layers.
    hidden: usize,
    /// Latent dimensions.
    latent: usize,
    /// Epochs over `D_k`.
    epochs: usize,
    /// Minibatches per epoch, each an optimiser step.
    minibatches: usize,
    /// Adam's learning rate.
    learning_rate: f64,
}

/// Enough for the observations of the robots, which have 8 to 27 features that vary.
pub(super) const CONFIG: VaeConfig =
    VaeConfig { hidden: 64, latent: 8, epochs: 5, minibatches: 8, learning_rate: 1e-3 };

/// `q(z | o)` and `p(o | z)`: Linear, tanh, Linear each, with diagonal Gaussians. The decoder's standard deviations are
/// separate parameters.
pub(crate) struct Vae {
    epochs: usize,
    minibatches: usize,
    latent: usize,
    moments: Moments,
    parameters: Parameters,
    encoder: LayerStack,
    decoder: LayerStack,
    log_sigma: Var,
    adam: Adam,
}

/// The latent of some rows, `[R, latent]` each. `sigma` is the standard deviation, `exp(log variance / 2)`.
struct Latent {
    encoded: Tensor,
    mean: Vec<f64>,
    log_variance: Vec<f64>,
}

impl Latent {
    fn sigma(&self, i: usize) -> f64 {
        exp(0.5 * self.log_variance[i])
    }

    /// `mean + sigma * noise`.
    fn sample(&self, noise: &[f64]) -> Vec<f32> {
        let one = |i: usize| (self.mean[i] + self.sigma(i) * noise[i]) as f32;
        (0..noise.len()).map(one).collect()
    }

    /// `KL[q(z | o) || N(0, 1)]` of the elements `of`, nats.
    fn divergence(&self, of: std::ops::Range<usize>) -> f64 {
        let one = |i: usize| {
            let (mean, log_variance) = (self.mean[i], self.log_variance[i]);
            0.5 * (mean * mean + exp(log_variance) - 1.0 - log_variance)
        };
        of.map(one).sum()
    }
}

impl Vae {
    /// Networks for the moments' features, with weights initialised for agent `agent`.
    pub(super) fn new(
        config: VaeConfig,
        moments: Moments,
        (seed, agent): (RunSeed, u32),
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::DensityInitialisation).agent(agent));
        let mut parameters = Parameters::new();
        let features = moments.signals();
        let hidden = config.hidden;
        let latent = config.latent;
        let (tanh, identity) = (Activation::Tanh, Activation::Identity);
        let mut pair = |name: &str, from: usize, to: usize, gain: f64| {
            let (first, second) = (format!("{name}.hidden"), format!("{name}.output"));
            let first = LayerSpec::linear(&first, (from, hidden), tanh, TANH_GAIN);
            let second = LayerSpec::linear(&second, (hidden, to), identity, gain);
            LayerStack::declare(&mut parameters, &[first, second], &mut rng)
        };
        let encoder = pair("encoder", features, 2 * latent, ENCODER_GAIN)?;
        let decoder = pair("decoder", latent, features, DECODER_GAIN)?;
        let start = Tensor::full(START_LOG_SIGMA, features, &Device::Cpu)?;
        let log_sigma = parameters.add("log_sigma", start)?;
        let adam = AdamConfig {
            learning_rate: config.learning_rate,
            epsilon: EPSILON,
            max_gradient_norm: MAX_GRADIENT_NORM,
        };
        let (epochs, minibatches) = (config.epochs, config.minibatches);
        let adam = Adam::new(adam, &parameters);
        Ok(Self {
            epochs,
            minibatches,
            latent,
            moments,
            parameters,
            encoder,
            decoder,
            log_sigma,
            adam,
        })
    }

    /// Input of the networks, `[R, S]`. Features that are left out are 0.
    fn inputs(&self, observations: Observations<'_>) -> Vec<f32> {
        let feature = |row, i| {
            if self.moments.active[i] { self.moments.standard(row, i) as f32 } else { 0.0 }
        };
        let signals = 0..self.moments.signals();
        observations.rows().flat_map(|row| signals.clone().map(move |i| feature(row, i))).collect()
    }

    fn latent(&self, inputs: &[f32]) -> Result<Latent, MarlError> {
        let inputs = rows(inputs.to_vec(), self.moments.signals())?;
        let encoded = self.encoder.weights()?.apply(&inputs, None)?;
        let all = numbers(&encoded)?;
        let half = |from: usize| -> Vec<f64> {
            let rows = all.chunks_exact(2 * self.latent);
            rows.flat_map(|row| row[from..from + self.latent].iter().copied()).collect()
        };
        Ok(Latent { mean: half(0), log_variance: half(self.latent), encoded })
    }

    fn decoded(&self, z: &Tensor) -> Result<Tensor, MarlError> {
        Ok(self.decoder.weights()?.apply(z, None)?)
    }

    /// `log p(x | z)` of every row over active features, nats.
    fn reconstruction(
        &self,
        inputs: &[f32],
        latent: &Latent,
        noise: &[f64],
    ) -> Result<Vec<f64>, MarlError> {
        let mean = numbers(&self.decoded(&rows(latent.sample(noise), self.latent)?)?)?;
        let log_sigma = numbers(self.log_sigma.as_tensor())?;
        let width = self.moments.signals();
        let row = |(x, mean): (&[f32], &[f64])| -> f64 {
            let term = |i: usize| {
                let z = (f64::from(x[i]) - mean[i]) / exp(log_sigma[i]);
                -0.5 * z * z - log_sigma[i] - 0.5 * LOG_TWO_PI
            };
            self.moments.counted().map(term).sum()
        };
        Ok(inputs.chunks_exact(width).zip(mean.chunks_exact(width)).map(row).collect())
    }

    /// One ascent step on the mean evidence lower bound of some rows.
    fn step(&mut self, inputs: &[f32], noise: &[f64]) -> Result<(), MarlError> {
        self.adam.step(&self.parameters, &self.gradients(inputs, noise)?)?;
        self.project()
    }

    /// Gradients of minus the mean evidence lower bound of some rows, with one latent sample each. The sample separates
    /// the graphs of decoder and encoder; the gradient through it is computed by hand.
    fn gradients(&self, inputs: &[f32], noise: &[f64]) -> Result<Gradients, MarlError> {
        let latent = self.latent(inputs)?;
        let z = Var::from_tensor(&rows(latent.sample(noise), self.latent)?)?;
        let decoded = self.decoded(z.as_tensor())?;
        let (d_decoded, d_log_sigma) = self.reconstruction_gradient(inputs, &numbers(&decoded)?)?;
        let mut outer = Backward::from(&root(&[
            OutputGradient { output: &decoded, gradient: &d_decoded },
            OutputGradient { output: self.log_sigma.as_tensor(), gradient: &d_log_sigma },
        ])?)?;
        let d_z = by(&mut outer, &z, "latent")?;
        let d_encoded = latent_gradient(&latent, noise, &d_z, self.latent);
        let inner = root(&[OutputGradient { output: &latent.encoded, gradient: &d_encoded }])?;
        let mut inner = Backward::from(&inner)?;
        let gradient = |(index, var): (usize, &Var)| {
            let name = self.parameters.name_of(index);
            let backward = if name.starts_with("encoder") { &mut inner } else { &mut outer };
            by(backward, var, name)
        };
        let vars = self.parameters.vars().iter().enumerate();
        let all = vars.map(gradient).collect::<Result<_, MarlError>>()?;
        Ok(Gradients(all))
    }

    /// Gradient of minus the mean of [`Vae::reconstruction`] with respect to the decoded means and `log_sigma`.
    fn reconstruction_gradient(
        &self,
        inputs: &[f32],
        mean: &[f64],
    ) -> Result<(Vec<f64>, Vec<f64>), MarlError> {
        let log_sigma = numbers(self.log_sigma.as_tensor())?;
        let width = self.moments.signals();
        let share = width as f64 / inputs.len() as f64;
        let mut d_mean = vec![0.0; mean.len()];
        let mut d_log_sigma = vec![0.0; width];
        for row in (0..mean.len()).step_by(width) {
            for i in self.moments.counted() {
                let sigma = exp(log_sigma[i]);
                let z = (f64::from(inputs[row + i]) - mean[row + i]) / sigma;
                d_mean[row + i] = -share * z / sigma;
                d_log_sigma[i] += share * (1.0 - z * z);
            }
        }
        Ok((d_mean, d_log_sigma))
    }

    /// Clamps the decoder's standard deviations to the features' floor.
    fn project(&self) -> Result<(), MarlError> {
        let values = self.log_sigma.as_tensor().to_vec1::<f32>()?;
        let held = |(i, value): (usize, f32)| value.max(log(self.moments.floor(i)) as f32);
        let held: Vec<f32> = values.into_iter().enumerate().map(held).collect();
        let width = held.len();
        Ok(self.log_sigma.set(&Tensor::from_vec(held, width, &Device::Cpu)?)?)
    }

    /// Standard normal noise for the latents of `count` rows.
    fn noise(&self, count: usize, context: DensityContext, step: usize) -> Vec<f64> {
        let DensityContext { seed, iteration, agent, .. } = context;
        let draw = Draw::of(Purpose::DensityNoise).iteration(iteration).agent(agent);
        let mut rng = generator(seed, draw.step(step as u32));
        (0..count * self.latent).map(|_| f64::from(standard_normal(&mut rng))).collect()
    }
}

/// Gradient of the mean loss with respect to the encoder's output `[R, 2 latent]`: through the sample, and of
/// [`Latent::divergence`].
fn latent_gradient(latent: &Latent, noise: &[f64], d_z: &[f32], width: usize) -> Vec<f64> {
    let share = width as f64 / d_z.len() as f64;
    let by_z = |i: usize| f64::from(d_z[i]);
    let by_mean = |i: usize| by_z(i) + share * latent.mean[i];
    let by_log_variance = |i: usize| {
        let sigma = latent.sigma(i);
        0.5 * (by_z(i) * sigma * noise[i] + share * (sigma * sigma - 1.0))
    };
    let row = |start: usize| {
        let here = start..start + width;
        here.clone().map(by_mean).chain(here.map(by_log_variance)).collect::<Vec<_>>()
    };
    (0..d_z.len()).step_by(width).flat_map(row).collect()
}

impl Density for Vae {
    fn fit(
        &mut self,
        observations: Observations<'_>,
        context: DensityContext,
    ) -> Result<(), MarlError> {
        self.moments.fit(observations);
        if self.moments.features().0 == 0 {
            return Ok(());
        }
        let inputs = self.inputs(observations);
        let width = self.moments.signals();
        let DensityContext { seed, iteration, agent, .. } = context;
        let draw = Draw::of(Purpose::DensityMinibatch).iteration(iteration).agent(agent);
        for epoch in 0..self.epochs {
            let noise = self.noise(observations.count(), context, epoch);
            let draw = draw.step(epoch as u32);
            for part in minibatches(observations.count(), self.minibatches, seed, draw) {
                self.step(&picked(&inputs, &part, width), &picked(&noise, &part, self.latent))?;
            }
        }
        Ok(())
    }

    /// `E_q[log p(o | z)] - KL[q(z | o) || N(0, 1)]`. The expectation is over a sample and its reflection, so that
    /// terms linear in the noise cancel. The noise differs from that of the fit and of other
    /// queries.
    fn log_prob(
        &self,
        observations: Observations<'_>,
        context: DensityContext,
    ) -> Result<Vec<f64>, MarlError> {
        let inputs = self.inputs(observations);
        let latent = self.latent(&inputs)?;
        let noise = self.noise(observations.count(), context, self.epochs + context.query as usize);
        let mirrored: Vec<f64> = noise.iter().map(|x| -x).collect();
        let there = self.reconstruction(&inputs, &latent, &noise)?;
        let back = self.reconstruction(&inputs, &latent, &mirrored)?;
        let volume = self.moments.log_volume();
        let row = |(i, (there, back)): (usize, (f64, f64))| {
            let divergence = latent.divergence(i * self.latent..(i + 1) * self.latent);
            0.5 * (there + back) - divergence - volume
        };
        Ok(there.into_iter().zip(back).enumerate().map(row).collect())
    }

    fn features(&self) -> (usize, usize) {
        self.moments.features()
    }

    /// Visits the moments, `network.NAME` and `optimizer.NAME`.
    fn visit(&mut self, prefix: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.moments.visit(prefix, visitor)?;
        visit_parameters(visitor, &format!("{prefix}network."), &self.parameters)?;
        self.adam.visit(&format!("{prefix}optimizer."), visitor)
    }
}

/// The rows `part` of `[R, width]` values.
fn picked<V: Copy>(from: &[V], part: &[usize], width: usize) -> Vec<V> {
    part.iter().flat_map(|&row| from[row * width..(row + 1) * width].iter().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimisation::tests::meets_finite_differences;

    #[test]
    fn the_gradient_matches_finite_differences() {
        let moments = Moments::new(vec![0, 1]);
        let small =
            VaeConfig { hidden: 16, latent: 2, minibatches: 4, learning_rate: 1e-2, ..CONFIG };
        let mut vae = Vae::new(small, moments, (RunSeed(1), 0)).unwrap();
        let data = [0.3, -1.0, 2.0, 0.4, -0.7, 1.5];
        let (observations, context) = (
            Observations { data: &data, width: 2 },
            DensityContext { seed: RunSeed(1), iteration: 0, agent: 0, query: 0 },
        );
        vae.fit(observations, context).unwrap();
        let (inputs, noise) = (vae.inputs(observations), vae.noise(3, context, 7));
        let loss = || {
            let latent = vae.latent(&inputs).unwrap();
            let likelihood: f64 =
                vae.reconstruction(&inputs, &latent, &noise).unwrap().iter().sum();
            (latent.divergence(0..latent.mean.len()) - likelihood) / 3.0
        };
        let found = vae.gradients(&inputs, &noise).unwrap();
        for (var, gradient) in vae.parameters.vars().iter().zip(&found.0) {
            let all = gradient.len();
            let used = meets_finite_differences(&loss, (var, gradient), 0..all, (1e-2, 1e-4));
            assert!(2 * used > all, "{used} of {all} have a slope");
        }
    }
}
