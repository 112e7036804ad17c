//! Running mean and standard deviation of one value's returns, so that its targets are near 1.

use libm::sqrt;

use crate::error::MarlError;
use crate::state::{Visitor, visit_numbers};

/// Lower bound of the accumulated weight before a division by it.
const MINIMAL_WEIGHT: f64 = 1e-5;
/// Lower bound of the variance, in squared units of the return.
const MINIMAL_VARIANCE: f64 = 1e-2;

/// Exponential averages of returns and their squares, corrected for their start at 0. Before the first update the mean
/// is 0 and the standard deviation 0.1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueNormalizer {
    beta: f64,
    mean: f64,
    square: f64,
    weight: f64,
}

impl ValueNormalizer {
    /// A normaliser without data, with decay `beta` per update.
    #[must_use]
    pub fn new(beta: f64) -> Self {
        Self { beta, mean: 0.0, square: 0.0, weight: 0.0 }
    }

    /// Adds the returns `[R]` of one iteration.
    pub fn update(&mut self, returns: &[f64]) {
        let count = returns.len() as f64;
        let mean = returns.iter().sum::<f64>() / count;
        let square = returns.iter().map(|&x| x * x).sum::<f64>() / count;
        let blend = |old: f64, new: f64| self.beta * old + (1.0 - self.beta) * new;
        let (mean, square, weight) =
            (blend(self.mean, mean), blend(self.square, square), blend(self.weight, 1.0));
        (self.mean, self.square, self.weight) = (mean, square, weight);
    }

    /// Mean and standard deviation of the returns, in units of the return.
    pub(crate) fn mean_and_deviation(&self) -> (f64, f64) {
        let weight = self.weight.max(MINIMAL_WEIGHT);
        let mean = self.mean / weight;
        (mean, sqrt((self.square / weight - mean * mean).max(MINIMAL_VARIANCE)))
    }

    /// Converts a return to normalised units.
    #[must_use]
    pub fn normalize(&self, value: f64) -> f64 {
        let (mean, deviation) = self.mean_and_deviation();
        (value - mean) / deviation
    }

    /// Converts a normalised value to units of the return.
    pub(crate) fn denormalize(&self, value: f64) -> f64 {
        let (mean, deviation) = self.mean_and_deviation();
        value * deviation + mean
    }

    /// State to store: weighted mean, weighted square, weight.
    #[must_use]
    pub fn state(&self) -> [f64; 3] {
        [self.mean, self.square, self.weight]
    }

    /// Visits the state as the array `name`.
    pub(crate) fn visit(&mut self, name: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        let mut state = self.state().to_vec();
        visit_numbers(visitor, name, &mut state)?;
        self.restore([state[0], state[1], state[2]]);
        Ok(())
    }

    /// Restores a stored state.
    pub fn restore(&mut self, [mean, square, weight]: [f64; 3]) {
        (self.mean, self.square, self.weight) = (mean, square, weight);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_update_gives_the_batch_mean_and_standard_deviation_for_every_beta() {
        for beta in [0.0, 0.9, 0.99999] {
            let mut normalizer = ValueNormalizer::new(beta);
            normalizer.update(&[1.0, 3.0, 5.0]); // mean 3, variance 8/3
            let (mean, deviation) = normalizer.mean_and_deviation();
            assert!((mean - 3.0).abs() < 1e-6, "beta {beta}: mean {mean}");
            assert!((deviation - 1.632_993_161_8).abs() < 1e-6, "beta {beta}: {deviation}");
        }
    }

    #[test]
    fn without_data_the_standard_deviation_is_a_tenth_and_normalising_is_invertible() {
        let normalizer = ValueNormalizer::new(0.99999);
        assert_eq!(normalizer.mean_and_deviation(), (0.0, 0.1));
        assert!((normalizer.denormalize(normalizer.normalize(3.7)) - 3.7).abs() < 1e-12);
    }
}
