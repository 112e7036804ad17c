//! Bringing features to mean 0 and deviation 1 by statistics that somebody else gathered.

use crate::arrays::{Array, NamedArrays};

/// Standardised features are held within `[-LIMIT, LIMIT]`, deviations.
pub const LIMIT: f32 = 10.0;

pub(crate) const MEAN: &str = "input.mean";
pub(crate) const INVERSE: &str = "input.inverse_deviation";

/// What every feature is standardised by.
#[derive(Clone, Debug, PartialEq)]
pub struct Standardisation {
    /// Subtracted from the feature, `[features]`.
    pub mean: Vec<f32>,
    /// Multiplied with what is left, `[features]`: 1 / deviation.
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

    /// As a snapshot carries it.
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
    fn features_lose_their_mean_and_their_unit_and_are_held_at_ten_deviations() {
        let standardisation = Standardisation { mean: vec![1.0, -2.0], inverse: vec![0.5, 4.0] };
        let mut rows = [3.0, -1.0, -99.0, 1.0];
        standardisation.apply(&mut rows);
        assert_eq!(rows, [1.0, 4.0, -10.0, 10.0]); // (-99 - 1) / 2 = -50 and (1 + 2) * 4 = 12
    }
}
