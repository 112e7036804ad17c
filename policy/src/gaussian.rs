//! The diagonal Gaussian distribution of continuous actions.

use candle_core::Tensor;

/// `1/2 log 2 pi`.
pub(crate) const HALF_LOG_TWO_PI: f32 = 0.918_938_5;

/// A trainable diagonal Gaussian over `R` rows of `A` action dimensions.
#[derive(Clone, Debug)]
pub struct Gaussian {
    /// Means, `[R, A]`, in units of half an action's range.
    pub mean: Tensor,
    /// Standard deviations, the same in every row, `[A]`.
    pub sigma: Tensor,
    /// Loadings of the noise that all agents share, `[A, K]`; `None` if the noise is independent.
    pub loading: Option<Tensor>,
}

/// `sum_d -1/2 ((a_d - mu_d) / sigma_d)^2 - log sigma_d - 1/2 log 2 pi`, nats. All slices are `[A]`.
#[must_use]
pub fn log_prob(mean: &[f32], sigma: &[f32], action: &[f32]) -> f32 {
    let dimensions = mean.iter().zip(sigma).zip(action);
    dimensions
        .map(|((&mean, &sigma), &action)| {
            let z = (action - mean) / sigma;
            -0.5 * z * z - libm::logf(sigma) - HALF_LOG_TWO_PI
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_density_matches_a_hand_worked_case() {
        // (1 - 0) / .5 = 2 and 0: -2 - ln .5 - .9189 - ln .25 - .9189 = -1.758437
        let found = log_prob(&[0.0, 3.0], &[0.5, 0.25], &[1.0, 3.0]);
        assert!((found + 1.758_436).abs() < 1e-5, "{found}");
    }
}
