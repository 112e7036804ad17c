//! Learning rates: decay over a run, and adaptation to the KL divergence of an update.

use serde::{Deserialize, Serialize};

/// Decay of the learning rates of actors and critics over a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LearningRateDecay {
    /// Constant.
    None,
    /// Linear, to 0 after the last iteration.
    Linear,
}

impl LearningRateDecay {
    /// `lr_k / lr_0`, the fraction of the configured learning rate in iteration `iteration` of `iterations`.
    #[must_use]
    pub fn share(self, iteration: u64, iterations: u64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Linear => linear_share(iteration, iterations),
        }
    }
}

/// `1 - k / K` for iteration `k` of `K`, counted from 0, as in HARL; 0 after the last iteration.
fn linear_share(iteration: u64, iterations: u64) -> f64 {
    iterations.saturating_sub(iteration) as f64 / iterations.max(1) as f64
}

/// Factor of one increase or decrease. rsl_rl uses 1.5 for updates of 100,000 rows. An update here has about a
/// thousand, so its divergence is noisier.
const STEP: f64 = 1.2;
/// A divergence within this factor of the desired one changes nothing; rsl_rl uses 2.
const NEAR: f64 = 1.5;
/// The smallest fraction. From it, about twenty updates lead back to the configured learning rate.
const SMALLEST: f64 = 0.02;

/// The fraction of the configured learning rate for an agent's next update, at most 1. `share` is the current fraction,
/// `kl` the divergence of the last update and `desired` the wanted one, above 0, in nats. A NaN `kl` changes nothing.
pub(crate) fn adapted(share: f64, kl: f64, desired: f64) -> f64 {
    let factor = match kl / desired {
        far if far > NEAR => 1.0 / STEP,
        far if far < 1.0 / NEAR => STEP,
        _ => 1.0,
    };
    (share * factor).clamp(SMALLEST, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_learning_rate_decreases_after_large_divergences_and_increases_after_small_ones() {
        assert_eq!(adapted(0.6, 0.016, 0.01), 0.6 / 1.2);
        assert_eq!(adapted(0.6, 0.006, 0.01), 0.6 * 1.2);
        for kl in [0.007, 0.01, 0.014, f64::NAN] {
            assert_eq!(adapted(0.6, kl, 0.01), 0.6);
        }
    }

    #[test]
    fn an_adapted_learning_rate_is_at_most_the_configured_one_and_above_zero() {
        assert_eq!(adapted(0.9, 0.0, 0.01), 1.0);
        assert_eq!(adapted(0.02, f64::INFINITY, 0.01), 0.02);
    }

    #[test]
    fn the_learning_rate_falls_linearly_to_zero_or_is_constant() {
        let shares = [0, 1, 2, 3, 5].map(|k| LearningRateDecay::Linear.share(k, 4));
        assert_eq!(shares, [1.0, 0.75, 0.5, 0.25, 0.0]);
        assert_eq!(LearningRateDecay::None.share(3, 4), 1.0);
    }
}
