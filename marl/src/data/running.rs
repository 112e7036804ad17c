//! Running mean and variance of every feature over all rows of a run.

use libm::sqrt;
use policy::Standardisation;

use crate::error::MarlError;
use crate::state::{Visitor, visit_number, visit_numbers};

/// A standard deviation of at most this, in units of the feature, counts as 0: rounding alone can cause it.
const SMALLEST_DEVIATION: f64 = 1e-6;

/// Number of rows for which given statistics count: a tenth of the steps of a default run, so that its own observations prevail
/// in its course.
const GIVEN_ROWS: f64 = 100_000.0;

/// Moments of features, merged once per iteration.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RunningMoments {
    /// Number of rows.
    count: f64,
    /// NaN for a feature of unknown value that never varied; the first rows then determine its moments.
    mean: Vec<f64>,
    /// Sums of squared deviations from the mean.
    squares: Vec<f64>,
}

impl RunningMoments {
    /// Moments of `features` features without rows.
    pub(crate) fn new(features: usize) -> Self {
        Self { count: 0.0, mean: vec![0.0; features], squares: vec![0.0; features] }
    }

    /// Moments of [`GIVEN_ROWS`] rows with this standardisation.
    pub(crate) fn of(standardisation: &Standardisation) -> Self {
        let one = |(&mean, &inverse): (&f32, &f32)| match (mean, f64::from(inverse)) {
            (0.0, 1.0) => (f64::NAN, 0.0),
            (mean, inverse) => (f64::from(mean), GIVEN_ROWS / (inverse * inverse)),
        };
        let features = standardisation.mean.iter().zip(&standardisation.inverse);
        let (mean, squares) = features.map(one).unzip();
        Self { count: GIVEN_ROWS, mean, squares }
    }

    /// Adds `rows` `[R, features]`. Chan's merge of `n_a` with `n_b` rows whose means differ by `d`:
    /// `mean = mean_a + d n_b / n`, `squares = squares_a + squares_b + d^2 n_a n_b / n`. Sums are in the order of rows.
    pub(crate) fn take_in(&mut self, rows: &[f32]) {
        let features = self.mean.len();
        let before = self.count;
        let new = (rows.len() / features) as f64;
        if new == 0.0 {
            return;
        }
        self.count = before + new;
        for feature in 0..features {
            let column = || rows[feature..].iter().step_by(features).map(|&x| f64::from(x));
            let mean = column().sum::<f64>() / new;
            let squares = column().map(|x| (x - mean) * (x - mean)).sum::<f64>();
            if self.mean[feature].is_nan() {
                self.mean[feature] = mean;
                self.squares[feature] = squares * self.count / new;
                continue;
            }
            let apart = mean - self.mean[feature];
            self.mean[feature] += apart * new / self.count;
            self.squares[feature] += squares + apart * apart * before * new / self.count;
        }
    }

    /// Standardisation to mean 0 and standard deviation 1. A feature that never varied, such as an agent's index, is
    /// not changed; before the first rows this holds for all.
    pub(crate) fn standardisation(&self) -> Standardisation {
        let rows = self.count.max(1.0);
        let one = |(&mean, &squares): (&f64, &f64)| match sqrt(squares / rows) {
            deviation if deviation > SMALLEST_DEVIATION => (mean as f32, (1.0 / deviation) as f32),
            _ => (0.0, 1.0),
        };
        let (mean, inverse) = self.mean.iter().zip(&self.squares).map(one).unzip();
        Standardisation { mean, inverse }
    }

    /// Visits `PREFIX` + `count`, `mean`, `squares`.
    pub(crate) fn visit(
        &mut self,
        prefix: &str,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        visit_number(visitor, &format!("{prefix}count"), &mut self.count)?;
        visit_numbers(visitor, &format!("{prefix}mean"), &mut self.mean)?;
        visit_numbers(visitor, &format!("{prefix}squares"), &mut self.squares)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two features. The second never varies.
    fn moments(iterations: &[&[f32]]) -> RunningMoments {
        let mut moments = RunningMoments::new(2);
        iterations.iter().for_each(|rows| moments.take_in(rows));
        moments
    }

    #[test]
    fn merged_moments_match_a_worked_case_and_those_of_all_rows() {
        // 1, 3 have mean 2 and squares 2; together with 8: mean 4, squares 9 + 1 + 16.
        let merged = moments(&[&[1.0, 0.5, 3.0, 0.5], &[8.0, 0.5]]);
        assert_eq!((merged.count, merged.mean[0], merged.squares[0]), (3.0, 4.0, 26.0));
        assert_eq!(merged, moments(&[&[1.0, 0.5, 3.0, 0.5, 8.0, 0.5]]));
    }

    #[test]
    fn given_statistics_count_for_many_rows_and_a_feature_without_any_takes_those_of_its_first_rows()
     {
        let given = Standardisation { mean: vec![0.1, 0.0], inverse: vec![0.3, 1.0] };
        let mut moments = RunningMoments::of(&given);
        assert_eq!(moments.standardisation(), given);
        moments.take_in(&[0.1, 7.0, 0.1, 7.0]);
        let after = moments.standardisation();
        assert_eq!((after.mean[1], after.inverse[1]), (0.0, 1.0), "it did not vary");
        assert!((after.mean[0] - 0.1).abs() < 1e-6 && (after.inverse[0] - 0.3).abs() < 1e-5);
        let mut varying = RunningMoments::of(&given);
        varying.take_in(&[0.1, 3.0, 0.1, 7.0]);
        assert_eq!(
            (varying.standardisation().mean[1], varying.standardisation().inverse[1]),
            (5.0, 0.5)
        );
    }

    #[test]
    fn a_feature_is_standardised_unless_it_never_varied() {
        let mut rows = [7.0, 0.5];
        moments(&[&[1.0, 0.5, 5.0, 0.5]]).standardisation().apply(&mut rows); // mean 3, standard deviation 2
        assert_eq!(rows, [2.0, 0.5]);
        moments(&[]).standardisation().apply(&mut rows);
        assert_eq!(rows, [2.0, 0.5]);
    }
}
