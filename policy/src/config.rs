//! Settings of the actor networks.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Kind of actor network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CoreKind {
    /// Linear, tanh, GRU, LayerNorm: the paper's actor.
    Gru,
    /// Layers of Linear, ReLU, LayerNorm; not recurrent.
    Mlp,
}

/// Normalisation of a network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputNorm {
    /// None, for inputs that are already scaled.
    None,
    /// A LayerNorm, as in HARL. It removes the mean and the scale of each row.
    LayerNorm,
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
}

/// A value outside its range.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("{key} is {found}, expected {expected}")]
pub struct ConfigError {
    /// Key in the run's configuration.
    pub key: &'static str,
    /// Value found.
    pub found: String,
    /// Values allowed.
    pub expected: &'static str,
}

impl PolicyConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first key with a value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let size = |size: usize| (size.to_string(), (1..=4096).contains(&size));
        let count = |count: usize, most: usize| (count.to_string(), (1..=most).contains(&count));
        let real = |x: f32, from: f32, to: f32| (x.to_string(), x > from && x <= to);
        let floor = self.sigma_floor;
        let is_below_start = floor > 0.0 && f64::from(floor) < INITIAL_SIGMA;
        let scale = self.sigma_scale;
        let is_above_start = f64::from(scale) > INITIAL_SIGMA && scale <= 10.0;
        let checks = [
            ("policy.encoder", size(self.encoder), "1 to 4096"),
            ("policy.hidden", size(self.hidden), "1 to 4096"),
            ("policy.width", size(self.width), "1 to 4096"),
            ("policy.layers", count(self.layers, 16), "1 to 16"),
            (
                "policy.backpropagation_steps",
                count(self.backpropagation_steps, 10_000),
                "1 to 10000",
            ),
            (
                "policy.sigma_scale",
                (scale.to_string(), is_above_start),
                "above the initial sigma of 0.36552929, at most 10",
            ),
            (
                "policy.sigma_floor",
                (floor.to_string(), is_below_start),
                "above 0 and below the initial sigma of 0.36552929",
            ),
            ("policy.head_gain", real(self.head_gain, 0.0, 10.0), "above 0, at most 10"),
        ];
        match checks.into_iter().find(|(_, (_, holds), _)| !holds) {
            Some((key, (found, _), expected)) => Err(ConfigError { key, found, expected }),
            None => Ok(()),
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

    pub(crate) fn valid() -> PolicyConfig {
        PolicyConfig {
            core: CoreKind::Gru,
            input_norm: InputNorm::LayerNorm,
            encoder: 64,
            hidden: 64,
            width: 128,
            layers: 3,
            backpropagation_steps: 10,
            sigma_scale: 0.5,
            sigma_floor: 0.05,
            head_gain: 0.01,
        }
    }

    #[test]
    fn an_error_names_the_key_the_value_and_the_allowed_range() {
        assert_eq!(valid().validate(), Ok(()));
        let error = PolicyConfig { hidden: 0, ..valid() }.validate().expect_err("no units");
        assert_eq!(error.to_string(), "policy.hidden is 0, expected 1 to 4096");
        let error = PolicyConfig { sigma_floor: 0.5, ..valid() }.validate().expect_err("too high");
        assert_eq!(error.key, "policy.sigma_floor");
        assert!(PolicyConfig { sigma_scale: f32::NAN, ..valid() }.validate().is_err());
    }

    #[test]
    fn the_initial_sigma_is_that_of_harl_and_between_the_bounds() {
        assert_eq!(valid().initial_log_std(), 1.0);
        for (sigma_floor, sigma_scale, key) in [
            (0.37, 0.5, "policy.sigma_floor"),
            (0.0, 0.5, "policy.sigma_floor"),
            (0.05, 0.36, "policy.sigma_scale"),
        ] {
            let config = PolicyConfig { sigma_floor, sigma_scale, ..valid() };
            assert_eq!(config.validate().expect_err("refused").key, key);
        }
        let wide = PolicyConfig { sigma_scale: 1.0, ..valid() };
        let sigma = 1.0 / (1.0 + libm::exp(-f64::from(wide.initial_log_std())));
        assert!((sigma - INITIAL_SIGMA).abs() < 1e-7, "{sigma}");
    }
}
