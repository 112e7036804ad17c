//! How step sizes shrink over a run. The index of the iteration decides, never a clock.

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

#[cfg(test)]
mod tests {
    use super::*;

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
