//! Standardisation of features to mean 0 and standard deviation 1, with given statistics.

use crate::arrays::{Array, NamedArrays};

/// Standardised features are clamped to `[-LIMIT, LIMIT]`, in standard deviations.
pub const LIMIT: f32 = 10.0;

pub(crate) const MEAN: &str = "input.mean";
pub(crate) const INVERSE: &str = "input.inverse_deviation";

/// Mean and inverse standard deviation of every feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Standardisation {
    /// Subtracted from the feature, `[features]`.
    pub mean: Vec<f32>,
    /// Factor after the subtraction, 1 / standard deviation, `[features]`.
    pub inverse: Vec<f32>,
}

impl Standardisation {
    /// `x = clamp((x - mean) / deviation, -LIMIT, LIMIT)` of every feature of `rows` `[R, features]`.
    pub fn apply(&self, rows: &mut [f32]) {
        for row in rows.chunks_exact_mut(self.mean.len()) {
            for ((x, mean), inverse) in row.iter_mut().zip(&self.mean).zip(&self.inverse) {
                *x = ((*x - mean) * inverse).clamp(-LIMIT, LIMIT);
            }
        }
    }

    /// The arrays in a snapshot.
    pub(crate) fn arrays(&self) -> NamedArrays {
        let vector = |name: &str, data: &[f32]| {
            (name.to_owned(), Array::F32 { shape: vec![data.len()], data: data.to_vec() })
        };
        NamedArrays::from([vector(MEAN, &self.mean), vector(INVERSE, &self.inverse)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_are_centred_scaled_and_clamped_at_ten_deviations() {
        let standardisation = Standardisation { mean: vec![1.0, -2.0], inverse: vec![0.5, 4.0] };
        let mut rows = [3.0, -1.0, -99.0, 1.0];
        standardisation.apply(&mut rows);
        assert_eq!(rows, [1.0, 4.0, -10.0, 10.0]); // (-99 - 1) / 2 = -50 and (1 + 2) * 4 = 12
    }
}
