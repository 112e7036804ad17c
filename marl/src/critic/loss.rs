//! The critic's loss, and how much of the returns its values explain.

use rayon::prelude::*;

use crate::objective::surrogate::mean_and_deviation;
use crate::rounding::rounded;
use crate::shape::assert_shape;

/// Huber's loss of an error and its derivative: `e^2 / 2` within `delta`, linear beyond.
pub(crate) fn huber(error: f64, delta: f64) -> (f64, f64) {
    if error.abs() <= delta {
        (0.5 * error * error, error)
    } else {
        (delta * (error.abs() - 0.5 * delta), delta * error.signum())
    }
}

/// The clipped value loss of one element, `max(huber(v - R), huber(v_clip - R))` with
/// `v_clip = v_old + clamp(v - v_old, +-clip)`, and its derivative with respect to `v`; in normalised units. With
/// `clip` = 0 the loss is `huber(v - R)`.
#[must_use]
pub fn value_loss(value: f64, old: f64, target: f64, clip: f64, delta: f64) -> (f64, f64) {
    let change = value - old;
    let free = huber(value - target, delta);
    if clip == 0.0 {
        return free;
    }
    let clipped = huber(old + change.clamp(-clip, clip) - target, delta);
    if clipped.0 > free.0 {
        (clipped.0, if change.abs() <= clip { clipped.1 } else { 0.0 })
    } else {
        free
    }
}

/// `1 - Var(R - V) / Var(R)` of values and returns `[T, B]`; 0 for constant returns.
///
/// # Panics
/// If the shapes differ.
pub(crate) fn explained_variance(values: &[f64], returns: &[f64]) -> f64 {
    assert_shape("values", values.len(), returns.len());
    let rest = rounded(returns.iter().zip(values).map(|(r, v)| r - v).collect());
    let spread = mean_and_deviation(returns).1;
    let left = mean_and_deviation(&rest).1;
    if spread > 0.0 { 1.0 - (left * left) / (spread * spread) } else { 0.0 }
}

/// Mean of [`explained_variance`] over `[V][T, B]`.
pub(super) fn mean_explained(values: &[Vec<f64>], returns: &[Vec<f64>]) -> f64 {
    let one = |(values, returns): (&Vec<f64>, &Vec<f64>)| explained_variance(values, returns);
    let shares: Vec<f64> = values.par_iter().zip(returns).map(one).collect();
    shares.iter().sum::<f64>() / shares.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clipped_value_loss_is_the_larger_of_the_two_losses() {
        // Unchanged value: plain squared error.
        assert_eq!(value_loss(1.0, 1.0, 3.0, 0.2, 10.0), (2.0, -2.0));
        // Beyond the clip towards the target: clamped at .2, whose loss is larger; derivative 0.
        let (loss, slope) = value_loss(2.0, 1.0, 3.0, 0.2, 10.0);
        assert!((loss - 0.5 * 1.8 * 1.8).abs() < 1e-12 && slope == 0.0);
        // Beyond the clip away from the target: the unclipped loss is larger and has a derivative.
        assert_eq!(value_loss(0.0, 1.0, 3.0, 0.2, 10.0), (4.5, -3.0));
        // Without clipping the old value has no effect.
        assert_eq!(value_loss(2.0, 1.0, 3.0, 0.0, 10.0), (0.5, -1.0));
    }

    #[test]
    fn values_equal_to_the_returns_have_an_explained_variance_of_one() {
        let returns = [1.0, 2.0, 3.0];
        assert_eq!(explained_variance(&returns, &returns), 1.0);
        assert_eq!(explained_variance(&[2.0; 3], &returns), 0.0);
        let (both, known) = (vec![returns.to_vec(); 2], vec![returns.to_vec(), vec![2.0; 3]]);
        assert_eq!(mean_explained(&known, &both), 0.5);
    }
}
