//! How step sizes change over a run: with the index of the iteration, or with how far an update moved a policy.

use serde::{Deserialize, Serialize};

/// How the step sizes of actors and critics shrink over a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LearningRateDecay {
    /// They stay.
    None,
    /// They fall in equal steps, to nothing after the last iteration.
    Linear,
}

impl LearningRateDecay {
    /// `lr_k / lr_0`, the share of the configured step size in iteration `iteration` of `iterations`.
    #[must_use]
    pub fn share(self, iteration: u64, iterations: u64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Linear => linear_share(iteration, iterations),
        }
    }
}

/// `1 - k / K` for iteration `k` of `K`, counted from 0, as HARL has it; 0 past the end.
fn linear_share(iteration: u64, iterations: u64) -> f64 {
    iterations.saturating_sub(iteration) as f64 / iterations.max(1) as f64
}

/// The factor by which the share grows or shrinks at once. rsl_rl has 1.5 for updates of 100,000 rows; here an update has
/// a thousand, and its divergence is noisier.
const STEP: f64 = 1.2;
/// A divergence within this factor of the desired one changes nothing; rsl_rl has 2.
const NEAR: f64 = 1.5;
/// The smallest share, from which a policy that moves again needs twenty updates back to the whole.
const SMALLEST: f64 = 0.02;

/// The share of the configured step size for an agent's next update, after one with `share` moved its policy by `kl` nats
/// where `desired` nats, above 0, were wanted. At most 1. A `kl` that is no number changes nothing.
#[must_use]
pub fn adapted(share: f64, kl: f64, desired: f64) -> f64 {
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
    fn a_policy_that_moves_too_far_takes_smaller_steps_and_one_that_hardly_moves_larger_ones_again()
    {
        assert_eq!(adapted(0.6, 0.016, 0.01), 0.6 / 1.2);
        assert_eq!(adapted(0.6, 0.006, 0.01), 0.6 * 1.2);
        for kl in [0.007, 0.01, 0.014, f64::NAN] {
            assert_eq!(adapted(0.6, kl, 0.01), 0.6);
        }
    }

    #[test]
    fn an_adapted_step_is_never_larger_than_configured_nor_nothing() {
        assert_eq!(adapted(0.9, 0.0, 0.01), 1.0);
        assert_eq!(adapted(0.02, f64::INFINITY, 0.01), 0.02);
    }

    #[test]
    fn over_four_iterations_the_step_size_falls_by_quarters() {
        let shares = [0, 1, 2, 3].map(|k| LearningRateDecay::Linear.share(k, 4));
        assert_eq!(shares, [1.0, 0.75, 0.5, 0.25]);
    }

    #[test]
    fn without_decay_the_step_size_stays() {
        assert_eq!(LearningRateDecay::None.share(3, 4), 1.0);
    }

    #[test]
    fn a_run_that_is_over_takes_no_step() {
        assert_eq!(LearningRateDecay::Linear.share(5, 4), 0.0);
    }
}
