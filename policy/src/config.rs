//! Settings of the actor networks.

use std::ops::Bound;

use serde::{Deserialize, Serialize};

use crate::head::Head;
use crate::setting::{SettingError, between, within};
use crate::shared_noise::{LARGEST_LOADING, MAX_HOLD, MAX_SIGNAL, SharedNoise};

/// Kind of actor network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CoreKind {
    /// Linear, tanh, GRU, LayerNorm: the paper's actor.
    Gru,
    /// Layers of Linear, ReLU, LayerNorm; not recurrent.
    Mlp,
}

/// Normalisation before a layer of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputNorm {
    /// None, for inputs that are already scaled.
    None,
    /// A LayerNorm, as in HARL. It removes the mean and the scale of each row.
    LayerNorm,
}

/// Exploration noise of several agents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// Every agent draws its own noise.
    Independent,
    /// A part of the noise is a signal that all agents share.
    Shared,
}

/// Sigma of an untrained policy, in units of half an action's range: `sigmoid(1) / 2`, as in HARL.
const INITIAL_SIGMA: f64 = 0.365_529_29;

/// Sizes and initialisation of every actor network. `configs/base.toml` has the defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// Kind of network.
    pub core: CoreKind,
    /// Normalisation of the network's input.
    pub input_norm: InputNorm,
    /// Units of the GRU core's encoder.
    pub encoder: usize,
    /// Recurrent units of the GRU core.
    pub hidden: usize,
    /// Units per layer of the MLP core.
    pub width: usize,
    /// Layers of the MLP core.
    pub layers: usize,
    /// Steps of backpropagation through time, and between stored recurrent states.
    pub backpropagation_steps: usize,
    /// Upper bound of sigma, in units of half an action's range.
    pub sigma_scale: f32,
    /// Lower bound of sigma, in units of half an action's range.
    pub sigma_floor: f32,
    /// Gain of the orthogonal initialisation of the action head.
    pub head_gain: f32,
    /// Noise of the agents' actions; absent: independent.
    pub noise: Option<Noise>,
    /// Shared noise: numbers of the signal; absent: 1.
    pub noise_size: Option<usize>,
    /// Shared noise: steps for which the signal stays the same; absent: 1.
    pub noise_hold: Option<u32>,
    /// Shared noise: correlation of each action's noise with the signal, at most 0.95; absent or 0: learnt.
    pub noise_loading: Option<f32>,
    /// Shared noise: environment steps in which the loadings decrease linearly to 0; absent or 0: they stay.
    pub noise_decay_steps: Option<u64>,
}

impl PolicyConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first key with a value out of range.
    pub fn validate(&self) -> Result<(), SettingError> {
        for (key, size) in [
            ("policy.encoder", self.encoder),
            ("policy.hidden", self.hidden),
            ("policy.width", self.width),
        ] {
            // The layer norm of a single unit is 0.
            between(key, size, 2, 4096)?;
        }
        between("policy.layers", self.layers, 1, 16)?;
        between("policy.backpropagation_steps", self.backpropagation_steps, 1, 10_000)?;
        let initial = INITIAL_SIGMA as f32;
        let above = (Bound::Excluded(initial), Bound::Included(10.0));
        let range = format!("above the initial sigma of {INITIAL_SIGMA}, at most 10");
        within("policy.sigma_scale", self.sigma_scale, above, &range)?;
        let range = format!("above 0 and below the initial sigma of {INITIAL_SIGMA}");
        within("policy.sigma_floor", self.sigma_floor, f32::MIN_POSITIVE..initial, &range)?;
        let gains = f32::MIN_POSITIVE..=10.0;
        within("policy.head_gain", self.head_gain, gains, "above 0, at most 10")?;
        let noise = self.shared_noise();
        between("policy.noise_size", noise.size, 1, MAX_SIGNAL)?;
        between("policy.noise_hold", noise.hold, 1, MAX_HOLD)?;
        between("policy.noise_loading", noise.loading.unwrap_or_default(), 0.0, LARGEST_LOADING)
    }

    fn shared_noise(&self) -> SharedNoise {
        let (size, hold) = (self.noise_size.unwrap_or(1), self.noise_hold.unwrap_or(1));
        let loading = self.noise_loading.filter(|loading| *loading != 0.0);
        SharedNoise { size, hold, loading, share: None }
    }

    /// Fraction of the loadings of shared noise with which agents act after `env_steps` environment steps of a run.
    #[must_use]
    pub fn noise_share(&self, env_steps: u64) -> f64 {
        match self.noise_decay_steps {
            None | Some(0) => 1.0,
            Some(steps) => steps.saturating_sub(env_steps) as f64 / steps as f64,
        }
    }

    /// The distribution of a policy: `head`, with the configured noise if it is a Gaussian, also before tanh.
    #[must_use]
    pub fn with_noise(&self, head: Head) -> Head {
        match (self.noise, head) {
            (Some(Noise::Shared), Head::Gaussian) => Head::SharedGaussian(self.shared_noise()),
            (Some(Noise::Shared), Head::TanhGaussian { low, high, .. }) => {
                Head::TanhGaussian { low, high, noise: Some(self.shared_noise()) }
            }
            _ => head,
        }
    }

    /// Initial value of the parameter `log_std`, where `sigma = sigmoid(log_std) * sigma_scale`.
    #[must_use]
    pub fn initial_log_std(&self) -> f32 {
        let share = INITIAL_SIGMA / f64::from(self.sigma_scale);
        libm::log(share / (1.0 - share)) as f32
    }

    /// Width of the recurrent state, 0 without a GRU.
    #[must_use]
    pub fn hidden_size(&self) -> usize {
        match self.core {
            CoreKind::Gru => self.hidden,
            CoreKind::Mlp => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn valid() -> PolicyConfig {
        crate::probe::config(CoreKind::Gru)
    }

    #[test]
    fn a_value_out_of_range_is_refused_by_its_key() {
        assert_eq!(valid().validate(), Ok(()));
        for (key, changed) in [
            ("policy.hidden", PolicyConfig { hidden: 0, ..valid() }),
            ("policy.layers", PolicyConfig { layers: 17, ..valid() }),
            ("policy.sigma_scale", PolicyConfig { sigma_scale: f32::NAN, ..valid() }),
            ("policy.noise_size", PolicyConfig { noise_size: Some(0), ..valid() }),
            ("policy.noise_hold", PolicyConfig { noise_hold: Some(0), ..valid() }),
            ("policy.noise_loading", PolicyConfig { noise_loading: Some(0.96), ..valid() }),
        ] {
            assert_eq!(changed.validate().expect_err("refused").key, key);
        }
    }

    #[test]
    fn loadings_decrease_linearly_to_zero_or_stay() {
        let decaying = PolicyConfig { noise_decay_steps: Some(400), ..valid() };
        let shares = [0, 100, 200, 400, 500].map(|steps| decaying.noise_share(steps));
        assert_eq!(shares, [1.0, 0.75, 0.5, 0.0, 0.0]);
        for noise_decay_steps in [None, Some(0)] {
            assert_eq!(PolicyConfig { noise_decay_steps, ..valid() }.noise_share(500), 1.0);
        }
    }

    #[test]
    fn the_initial_sigma_is_that_of_harl_and_between_the_bounds() {
        assert_eq!(valid().initial_log_std(), 1.0);
        for (sigma_floor, sigma_scale, refused) in [
            (0.4, 0.5, "policy.sigma_floor = 0.4 is out of range: "),
            (0.0, 0.5, "policy.sigma_floor = 0 is out of range: "),
            (0.05, 0.36, "policy.sigma_scale = 0.36 is out of range: "),
        ] {
            let config = PolicyConfig { sigma_floor, sigma_scale, ..valid() };
            let message = config.validate().expect_err("refused").to_string();
            assert!(message.starts_with(refused), "{message}");
        }
        let wide = PolicyConfig { sigma_scale: 1.0, ..valid() };
        let sigma = 1.0 / (1.0 + libm::exp(-f64::from(wide.initial_log_std())));
        assert!((sigma - INITIAL_SIGMA).abs() < 1e-7, "{sigma}");
    }
}
