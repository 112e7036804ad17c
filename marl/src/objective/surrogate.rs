//! The parts of HAPPO's objective per row: ratio, clipped surrogate, sequential factor, normalised advantage.

use libm::{exp, sqrt};

use crate::shape::assert_shape;

/// Log-ratios are clamped to this many nats, so that no ratio and no product of a dozen of them overflows f32. A ratio
/// of `e^10` is far outside any clipping interval.
pub(crate) const LOG_RATIO_LIMIT: f64 = 10.0;

/// `pi_new(a|o) / pi_old(a|o)`: the exponential of the log-ratio, which is summed over action dimensions and clamped to
/// `LOG_RATIO_LIMIT`.
pub(crate) fn ratio(log_ratio: f64) -> f64 {
    exp(log_ratio.clamp(-LOG_RATIO_LIMIT, LOG_RATIO_LIMIT))
}

/// Whether [`ratio`] clamps a log-ratio.
pub(crate) fn is_clamped(log_ratio: f64) -> bool {
    log_ratio.abs() > LOG_RATIO_LIMIT
}

/// HAPPO's clipped surrogate of one row, `min(ratio A, clip(ratio, 1 - clip, 1 + clip) A)`, and its derivative with
/// respect to the ratio. At a tie the derivative is that of the unclipped branch.
pub(crate) fn clipped_surrogate(ratio: f64, advantage: f64, clip: f64) -> (f64, f64) {
    let free = ratio * advantage;
    let clipped = ratio.clamp(1.0 - clip, 1.0 + clip) * advantage;
    if free <= clipped { (free, advantage) } else { (clipped, 0.0) }
}

/// Lowest and highest sequential factor, `e^-10` and `e^10`.
pub(crate) fn factor_limits() -> (f64, f64) {
    (exp(-LOG_RATIO_LIMIT), exp(LOG_RATIO_LIMIT))
}

/// HAPPO's sequential factor `M' = M pi_new(a|o) / pi_old(a|o)`, by which earlier agents' updates weight the next
/// agent's advantage. All slices are `[R]`; log-probabilities in nats.
///
/// `M` is clamped to [`factor_limits`]. A NaN ratio leaves `M` unchanged, so that an invalid row of one agent does
/// not spoil the update of the next.
///
/// # Panics
/// If the shapes differ.
pub(crate) fn sequential_factor(
    factor: &[f64],
    log_prob_new: &[f64],
    log_prob_old: &[f64],
) -> Vec<f64> {
    assert_shape("log_prob_new", log_prob_new.len(), factor.len());
    assert_shape("log_prob_old", log_prob_old.len(), factor.len());
    let (lowest, highest) = factor_limits();
    let ratios = log_prob_new.iter().zip(log_prob_old).map(|(new, old)| ratio(new - old));
    let ratios = ratios.map(|ratio| if ratio.is_nan() { 1.0 } else { ratio });
    factor
        .iter()
        .zip(ratios)
        .map(|(factor, ratio)| (factor * ratio).clamp(lowest, highest))
        .collect()
}

/// `(A - mean) / (std + 1e-5)` over all rows, with the population standard deviation. `[R]` to `[R]`. Equal advantages
/// are 0: their mean may differ from them in the last bit, and the quotient would be noise.
#[must_use]
pub fn normalized_advantage(advantage: &[f64]) -> Vec<f64> {
    if advantage.windows(2).all(|pair| pair[0] == pair[1]) {
        return vec![0.0; advantage.len()];
    }
    let (mean, deviation) = mean_and_deviation(advantage);
    advantage.iter().map(|&a| (a - mean) / (deviation + 1e-5)).collect()
}

/// Mean and population standard deviation of `[R]` numbers, summed in order in f64; both 0 without numbers.
pub(crate) fn mean_and_deviation(numbers: &[f64]) -> (f64, f64) {
    let count = numbers.len().max(1) as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    let square = |&x: &f64| (x - mean) * (x - mean);
    (mean, sqrt(numbers.iter().map(square).sum::<f64>() / count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clipping_only_lowers_the_surrogate() {
        assert_eq!(clipped_surrogate(1.5, 2.0, 0.2), (2.4, 0.0)); // good action, already more likely
        assert_eq!(clipped_surrogate(0.5, 2.0, 0.2), (1.0, 2.0)); // good action, less likely: not clipped
        assert_eq!(clipped_surrogate(1.5, -2.0, 0.2), (-3.0, -2.0)); // bad action, more likely: not clipped
        assert_eq!(clipped_surrogate(0.5, -2.0, 0.2), (-1.6, 0.0)); // bad action, already less likely
        assert_eq!(clipped_surrogate(1.0, 2.0, 0.2), (2.0, 2.0)); // the first step is not clipped
    }

    #[test]
    fn the_ratio_of_extreme_log_probabilities_is_finite() {
        assert_eq!(ratio(0.0), 1.0);
        assert_eq!(ratio(2e9), exp(10.0));
        assert_eq!(ratio(-2e9), exp(-10.0));
    }

    #[test]
    fn the_factor_is_the_product_of_the_updated_agents_ratios() {
        let ln2 = core::f64::consts::LN_2;
        let first = sequential_factor(&[1.0, 1.0], &[-1.0 + ln2, -2.0], &[-1.0, -2.0]);
        let second = sequential_factor(&first, &[0.5 - ln2, 1.0 + ln2], &[0.5, 1.0]);
        assert!((first[0] - 2.0).abs() < 1e-12 && first[1] == 1.0);
        assert!((second[0] - 1.0).abs() < 1e-12 && (second[1] - 2.0).abs() < 1e-12);
    }

    #[test]
    fn normalised_advantages_have_mean_zero_and_standard_deviation_one() {
        let normal = normalized_advantage(&[1.0, 3.0]); // mean 2, standard deviation 1
        assert!((normal[0] + 1.0).abs() < 2e-5 && (normal[1] - 1.0).abs() < 2e-5);
        assert_eq!(normalized_advantage(&[7.0, 7.0]), vec![0.0, 0.0]);
        assert_eq!(normalized_advantage(&[1.1e30; 7]), vec![0.0; 7]);
    }

    #[test]
    fn a_factor_stays_within_its_limits_and_is_unchanged_by_a_nan_ratio() {
        let far = sequential_factor(&[exp(9.0), exp(-9.0)], &[5.0, -5.0], &[0.0, 0.0]);
        assert_eq!(far, vec![exp(LOG_RATIO_LIMIT), exp(-LOG_RATIO_LIMIT)]);
        assert_eq!(sequential_factor(&[2.0], &[f64::NAN], &[0.0]), vec![2.0]);
    }
}
