//! Action distributions: in a snapshot ([`Head`]) and in training ([`Distribution`]).

use rand::RngCore;
use serde::{Deserialize, Serialize};

use crate::categorical::{self, Categorical};
use crate::error::PolicyError;
use crate::gaussian::{self, Gaussian};
use crate::randomness::{standard_normal, uniform};
use crate::shared_noise::SharedNoise;
use crate::tanh_gaussian;

/// Action distribution, given the network's output; part of a snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Head {
    /// A Gaussian with the network's output as mean and learnt standard deviations; never clamped.
    Gaussian,
    /// As [`Head::Gaussian`], with a part of the noise shared by all agents.
    SharedGaussian(SharedNoise),
    /// One value, the index of a choice.
    Categorical {
        /// `K`, number of choices.
        choices: usize,
    },
    /// The network's output after tanh, scaled to the range. Exploration adds Gaussian noise and
    /// clamps to the range. The density is that of the noise before the clamp.
    Deterministic {
        /// Standard deviation of the noise, in the unit of `low` and `high`.
        noise_sigma: f32,
        /// Lowest action.
        low: f32,
        /// Highest action.
        high: f32,
    },
    /// Uniform over the range, independent of the observation. The mode is that of [`Head::Deterministic`], so that a
    /// policy can be evaluated during warm-up.
    Uniform {
        /// Lowest action.
        low: f32,
        /// Highest action.
        high: f32,
    },
    /// A Gaussian after tanh, scaled to the range; the network's output is its mean and, for each row, its standard
    /// deviation ([`tanh_gaussian`]).
    TanhGaussian {
        /// Lowest action.
        low: f32,
        /// Highest action.
        high: f32,
        /// How agents share a part of the noise; absent if it is independent.
        #[serde(skip_serializing_if = "Option::is_none")]
        noise: Option<SharedNoise>,
    },
}

impl Head {
    /// Half the width and the middle of the range to which the network's output in `(-1, 1)` is scaled; `None` if the
    /// output is not scaled.
    #[must_use]
    pub(crate) fn scale(self) -> Option<(f32, f32)> {
        match self {
            Self::Gaussian
            | Self::SharedGaussian(_)
            | Self::Categorical { .. }
            | Self::TanhGaussian { .. } => None,
            Self::Deterministic { low, high, .. } | Self::Uniform { low, high } => {
                Some((0.5 * (high - low), 0.5 * (high + low)))
            }
        }
    }

    /// The standard deviation of every action dimension, if it is not learnt and there is one.
    #[must_use]
    pub(crate) fn fixed_sigma(self) -> Option<f32> {
        match self {
            Self::Gaussian
            | Self::SharedGaussian(_)
            | Self::Categorical { .. }
            | Self::TanhGaussian { .. } => None,
            Self::Deterministic { noise_sigma, .. } => Some(noise_sigma),
            Self::Uniform { low, high } => Some((high - low) / 12.0_f32.sqrt()),
        }
    }

    /// How agents share a part of their noise; `None` if it is independent.
    #[must_use]
    pub fn shared_noise(self) -> Option<SharedNoise> {
        match self {
            Self::SharedGaussian(noise) => Some(noise),
            Self::TanhGaussian { noise, .. } => noise,
            _ => None,
        }
    }

    /// The same distribution with this fraction of the loadings of shared noise.
    #[must_use]
    pub fn with_noise_share(self, share: f32) -> Self {
        let scaled = |noise: SharedNoise| noise.scaled(share);
        match self {
            Self::SharedGaussian(noise) => Self::SharedGaussian(scaled(noise)),
            Self::TanhGaussian { low, high, noise } => {
                Self::TanhGaussian { low, high, noise: noise.map(scaled) }
            }
            other => other,
        }
    }

    /// Number of choices of a discrete action; `None` for a continuous one.
    #[must_use]
    pub fn choices(self) -> Option<usize> {
        match self {
            Self::Categorical { choices } => Some(choices),
            _ => None,
        }
    }

    /// Number of network outputs for `action` action values: means, means and deviations, or logits.
    #[must_use]
    pub fn outputs(self, action: usize) -> usize {
        match self {
            Self::Categorical { choices } => choices,
            Self::TanhGaussian { .. } => 2 * action,
            _ => action,
        }
    }

    /// Rejects an invalid range, standard deviation or number of choices for `action` action values.
    pub(crate) fn check(self, action: usize) -> Result<(), PolicyError> {
        let range = |low: f32, high: f32| low < high && low.is_finite() && high.is_finite();
        let holds = match self {
            Self::Gaussian => true,
            Self::SharedGaussian(noise) => noise.is_valid(),
            Self::Categorical { choices } => action == 1 && choices > 0,
            Self::Deterministic { noise_sigma, low, high } => {
                range(low, high) && noise_sigma > 0.0 && noise_sigma.is_finite()
            }
            Self::Uniform { low, high } => range(low, high),
            Self::TanhGaussian { low, high, noise } => {
                range(low, high) && noise.is_none_or(SharedNoise::is_valid)
            }
        };
        if holds {
            return Ok(());
        }
        Err(PolicyError::Snapshot(format!("{self:?} is invalid for {action} action values")))
    }

    /// Scales the network's output `[act]` to the mean action.
    pub(crate) fn scale_output(self, output: &mut [f32]) {
        if let Some((half, middle)) = self.scale() {
            output.iter_mut().for_each(|x| *x = *x * half + middle);
        }
    }

    /// Draws an action `[act]` from one row's output `[out]`, with the standard deviations given the signal that agents share, `[act]`,
    /// or the part of them that is the agent's own, `[act]`, if they depend on the observation.
    pub(crate) fn draw(
        self,
        output: &[f32],
        (sigma, own): (&[f32], &[f64]),
        rng: &mut impl RngCore,
        action: &mut [f32],
    ) {
        let means = output.iter().zip(sigma);
        let pairs = action.iter_mut().zip(means);
        match self {
            Self::Categorical { .. } => action[0] = categorical::draw(output, rng) as f32,
            Self::TanhGaussian { low, high, .. } => {
                tanh_gaussian::draw(output, ((low, high), own), rng, action);
            }
            Self::Uniform { low, high } => {
                pairs.for_each(|(action, _)| *action = low + (high - low) * uniform(rng));
            }
            Self::Gaussian | Self::SharedGaussian(_) => {
                pairs.for_each(|(action, (mean, sigma))| {
                    *action = mean + sigma * standard_normal(rng)
                });
            }
            Self::Deterministic { low, high, .. } => pairs.for_each(|(action, (mean, sigma))| {
                *action = (mean + sigma * standard_normal(rng)).clamp(low, high);
            }),
        }
    }

    /// The mode `[act]`: the mean, or the likeliest choice.
    pub(crate) fn mode(self, output: &[f32], action: &mut [f32]) {
        match self {
            Self::Categorical { .. } => action[0] = categorical::mode(output) as f32,
            Self::TanhGaussian { low, high, .. } => {
                tanh_gaussian::mode(output, (low, high), action)
            }
            _ => action.copy_from_slice(output),
        }
    }

    /// Log-density or log-probability, in nats, of an action `[act]`, with deviations as in [`Self::draw`]. The index of a choice
    /// must have been validated.
    pub(crate) fn log_prob(
        self,
        output: &[f32],
        (sigma, own): (&[f32], &[f64]),
        action: &[f32],
    ) -> f32 {
        match self {
            Self::Gaussian | Self::SharedGaussian(_) | Self::Deterministic { .. } => {
                gaussian::log_prob(output, sigma, action)
            }
            Self::Categorical { .. } => categorical::log_prob(output, action[0] as usize),
            Self::Uniform { low, high } => -(action.len() as f32) * libm::logf(high - low),
            Self::TanhGaussian { low, high, .. } => {
                tanh_gaussian::log_prob(output, ((low, high), own), action)
            }
        }
    }
}

/// A trainable distribution over `R` rows of actions.
#[derive(Clone, Debug)]
pub enum Distribution {
    /// Continuous actions.
    Gaussian(Gaussian),
    /// Discrete actions.
    Categorical(Categorical),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::randomness::{Draw, Purpose, RunSeed, generator};

    const EXPLORING: Head = Head::Deterministic { noise_sigma: 0.5, low: -2.0, high: 4.0 };
    const NOISE: SharedNoise = SharedNoise { size: 1, hold: 1, loading: None, share: None };
    const WARMING_UP: Head = Head::Uniform { low: -2.0, high: 4.0 };

    fn drawn(head: Head, mean: f32, count: usize) -> Vec<f32> {
        let mut rng = generator(RunSeed(1), Draw::of(Purpose::Action));
        let mut actions = vec![0.0; count];
        let sigma = vec![head.fixed_sigma().expect("not learnt"); count];
        head.draw(&vec![mean; count], (&sigma, &[]), &mut rng, &mut actions);
        actions
    }

    #[test]
    fn tanh_outputs_are_scaled_to_the_range_and_gaussian_means_are_not() {
        for head in [EXPLORING, WARMING_UP] {
            let mut outputs = [0.0, 1.0, -1.0];
            head.scale_output(&mut outputs);
            let close = |found: f32, expected: f32| (found - expected).abs() < 1e-5;
            assert!(close(outputs[0], 1.0) && close(outputs[1], 4.0) && close(outputs[2], -2.0));
        }
        let mut output = [7.0];
        Head::Gaussian.scale_output(&mut output);
        assert_eq!(output, [7.0]);
    }

    #[test]
    fn exploration_stays_around_the_mean_and_inside_the_range() {
        let actions = drawn(EXPLORING, 1.0, 10_000);
        let mean = actions.iter().sum::<f32>() / 1e4;
        let square = actions.iter().map(|a| (a - mean) * (a - mean)).sum::<f32>() / 1e4;
        assert!((mean - 1.0).abs() < 0.02 && (square - 0.25).abs() < 0.02, "{mean} {square}");
        assert!(drawn(EXPLORING, 3.9, 1000).iter().all(|a| (-2.0..=4.0).contains(a)));
        assert!(drawn(EXPLORING, 3.9, 1000).contains(&4.0));
    }

    #[test]
    fn warming_up_covers_the_range_evenly_with_a_constant_density() {
        let actions = drawn(WARMING_UP, 3.0, 10_000);
        let share = |from: f32, to: f32| {
            actions.iter().filter(|a| (from..to).contains(*a)).count() as f32 / 1e4
        };
        assert!((share(-2.0, -1.0) - 1.0 / 6.0).abs() < 0.02 && share(-2.0, 4.0) == 1.0);
        let one = WARMING_UP.log_prob(&[0.0; 2], (&[1.0; 2], &[]), &[3.0, -1.0]);
        assert!((one + 2.0 * libm::logf(6.0)).abs() < 1e-6);
    }

    #[test]
    fn a_head_without_a_range_or_without_noise_is_rejected() {
        for head in [EXPLORING, WARMING_UP, Head::Gaussian] {
            assert!(head.check(1).is_ok());
        }
        assert!(Head::TanhGaussian { low: 1.0, high: 2.0, noise: Some(NOISE) }.check(1).is_ok());
        assert!(Head::Categorical { choices: 3 }.check(2).is_err());
        for head in [
            Head::Uniform { low: 1.0, high: 1.0 },
            Head::TanhGaussian { low: 2.0, high: 1.0, noise: None },
            Head::TanhGaussian {
                low: 1.0,
                high: 2.0,
                noise: Some(SharedNoise { size: 0, ..NOISE }),
            },
            Head::Uniform { low: f32::NAN, high: 1.0 },
            Head::Deterministic { noise_sigma: 0.0, low: -1.0, high: 1.0 },
            Head::Categorical { choices: 0 },
            Head::SharedGaussian(SharedNoise { size: 0, ..NOISE }),
            Head::SharedGaussian(SharedNoise { hold: 0, ..NOISE }),
            Head::SharedGaussian(SharedNoise { loading: Some(1.0), ..NOISE }),
            Head::SharedGaussian(SharedNoise { share: Some(1.1), ..NOISE }),
        ] {
            assert!(head.check(1).is_err(), "{head:?}");
        }
    }
}
