//! Settings of the actor networks.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How an actor remembers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CoreKind {
    /// Linear, tanh, GRU, LayerNorm: the paper's actor.
    Gru,
    /// Layers of Linear, ReLU, LayerNorm; no memory.
    Mlp,
}

/// What stands between a network's input and its first layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputNorm {
    /// Nothing: for inputs that are scaled already.
    None,
    /// A LayerNorm, as in HARL. It removes what all features of a row have in common, and with it the scale of the row.
    LayerNorm,
}

/// When the learner computes stored recurrent states again with today's weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RefreshHidden {
    /// Every epoch starts chunks from the states of the rollout.
    Never,
    /// Before each epoch but the first.
    EveryEpoch,
}

/// Sizes and start of every actor network. The defaults stand in `configs/base.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// Which core.
    pub core: CoreKind,
    /// What stands before the core.
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
    /// Steps before a chunk whose recurrent states are computed again with today's weights, from the
    /// state stored that many steps before; 0 or a multiple of `backpropagation_steps`.
    pub burn_in: usize,
    /// When stored recurrent states are computed again.
    pub refresh_hidden: RefreshHidden,
    /// Sigma at the start, in units of the action.
    pub initial_sigma: f64,
    /// Upper end of sigma, in units of the action.
    pub sigma_scale: f32,
    /// Lower end of sigma, in units of the action.
    pub sigma_floor: f32,
    /// Gain of the orthogonal start of the action head.
    pub head_gain: f32,
}

/// A value outside its range.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("{key} is {found}, expected {expected}")]
pub struct ConfigError {
    /// Key in the run's configuration.
    pub key: &'static str,
    /// What it is.
    pub found: String,
    /// What it may be.
    pub expected: &'static str,
}

impl PolicyConfig {
    /// Checks every range.
    ///
    /// # Errors
    /// Names the first key that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let size = |size: usize| (size.to_string(), (1..=4096).contains(&size));
        let count = |count: usize, most: usize| (count.to_string(), (1..=most).contains(&count));
        let real = |x: f32, from: f32, to: f32| (x.to_string(), x > from && x <= to);
        let floor = self.sigma_floor;
        let below = floor > 0.0 && floor < self.sigma_scale;
        let open = f64::from(floor)..f64::from(self.sigma_scale);
        let memory = self.core != CoreKind::Mlp;
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
                (self.burn_in.to_string(), memory || self.burn_in == 0),
                "0 with policy.core = mlp",
            ),
            (
                "policy.refresh_hidden",
                ("every_epoch".to_owned(), memory || self.refresh_hidden == RefreshHidden::Never),
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

    /// Start of the parameter `log_std`, of which `sigma = sigmoid(log_std) * sigma_scale`.
    #[must_use]
    pub fn initial_log_std(&self) -> f32 {
        let share = self.initial_sigma / f64::from(self.sigma_scale);
        libm::log(share / (1.0 - share)) as f32
    }

    /// Width of the recurrent state, 0 without one.
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
    fn a_value_out_of_range_is_named_with_what_it_may_be() {
        assert_eq!(valid().validate(), Ok(()));
        let error = PolicyConfig { hidden: 0, ..valid() }.validate().expect_err("no units");
        assert_eq!(error.to_string(), "policy.hidden is 0, expected 1 to 4096");
        let error = PolicyConfig { sigma_floor: 0.5, ..valid() }.validate().expect_err("too high");
        assert_eq!(error.key, "policy.sigma_floor");
        assert!(PolicyConfig { sigma_scale: f32::NAN, ..valid() }.validate().is_err());
    }

    #[test]
    fn the_first_sigma_is_the_one_that_was_asked_for_and_lies_between_its_bounds() {
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
    fn states_are_computed_again_by_whole_chunks_and_only_by_a_core_that_has_some() {
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
