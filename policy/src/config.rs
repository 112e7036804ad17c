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

/// When the learner recomputes stored recurrent states with the current weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RefreshHidden {
    /// Chunks start from the states of the rollout in every epoch.
    Never,
    /// Before every epoch except the first.
    EveryEpoch,
}

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
    /// Number of steps before a chunk for which recurrent states are recomputed with the current weights, from the
    /// stored state at their start; 0 or a multiple of `backpropagation_steps`.
    pub burn_in: usize,
    /// When stored recurrent states are recomputed.
    pub refresh_hidden: RefreshHidden,
    /// Initial sigma, in units of half an action's range.
    pub initial_sigma: f64,
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
        let below = floor > 0.0 && floor < self.sigma_scale;
        let open = f64::from(floor)..f64::from(self.sigma_scale);
        let recurrent = self.core != CoreKind::Mlp;
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
                "policy.burn_in",
                (self.burn_in.to_string(), self.burn_in.is_multiple_of(self.backpropagation_steps)),
                "0 or a multiple of policy.backpropagation_steps",
            ),
            (
                "policy.burn_in",
                (self.burn_in.to_string(), recurrent || self.burn_in == 0),
                "0 with policy.core = mlp",
            ),
            (
                "policy.refresh_hidden",
                (
                    "every_epoch".to_owned(),
                    recurrent || self.refresh_hidden == RefreshHidden::Never,
                ),
                "never with policy.core = mlp",
            ),
            ("policy.sigma_scale", real(self.sigma_scale, 0.0, 10.0), "above 0, at most 10"),
            (
                "policy.sigma_floor",
                (floor.to_string(), below),
                "above 0 and below policy.sigma_scale",
            ),
            (
                "policy.initial_sigma",
                (
                    self.initial_sigma.to_string(),
                    self.initial_sigma > open.start && self.initial_sigma < open.end,
                ),
                "above policy.sigma_floor and below policy.sigma_scale",
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
        let share = self.initial_sigma / f64::from(self.sigma_scale);
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
            burn_in: 0,
            refresh_hidden: RefreshHidden::Never,
            initial_sigma: 0.365_529_29,
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
    fn the_initial_sigma_has_the_configured_value_and_is_between_its_bounds() {
        for initial_sigma in [0.06, 0.25, 0.365_529_29, 0.49] {
            let config = PolicyConfig { initial_sigma, ..valid() };
            let log_std = f64::from(config.initial_log_std());
            let sigma = f64::from(config.sigma_scale) / (1.0 + libm::exp(-log_std));
            assert!((sigma - initial_sigma).abs() < 1e-7, "{sigma} {initial_sigma}");
            assert_eq!(config.validate(), Ok(()));
        }
        assert_eq!(valid().initial_log_std(), 1.0);
        for initial_sigma in [0.0, 0.05, 0.5, 0.6, f64::NAN] {
            let error = PolicyConfig { initial_sigma, ..valid() }.validate().expect_err("refused");
            assert_eq!(error.key, "policy.initial_sigma");
        }
    }

    #[test]
    fn states_are_recomputed_in_whole_chunks_and_only_with_a_recurrent_core() {
        let burn_in = |core, burn_in| PolicyConfig { core, burn_in, ..valid() }.validate();
        assert_eq!(burn_in(CoreKind::Gru, 20), Ok(()));
        for (refused, message) in [
            (
                burn_in(CoreKind::Gru, 15),
                "policy.burn_in is 15, expected 0 or a multiple of policy.backpropagation_steps",
            ),
            (burn_in(CoreKind::Mlp, 20), "policy.burn_in is 20, expected 0 with policy.core = mlp"),
            (
                PolicyConfig {
                    core: CoreKind::Mlp,
                    refresh_hidden: RefreshHidden::EveryEpoch,
                    ..valid()
                }
                .validate(),
                "policy.refresh_hidden is every_epoch, expected never with policy.core = mlp",
            ),
        ] {
            assert_eq!(refused.expect_err("refused").to_string(), message);
        }
    }
}
