//! An independent Gaussian per observation feature, as in the paper's experiments.

use libm::log;

use super::moments::Moments;
use crate::density::{Density, DensityContext, Observations};
use crate::distribution::gaussian::LOG_TWO_PI;
use crate::error::MarlError;
use crate::state::Visitor;

/// Mean and standard deviation of every signal feature that varies.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DiagonalGaussian(pub(super) Moments);

impl DiagonalGaussian {
    /// Eq. (4): `- sum_j (log sigma_j + (o_j - mu_j)^2 / (2 sigma_j^2))` over active features: the log-density without
    /// `-1/2 log 2 pi` per feature. `row` is `[obs]`; nats.
    pub(crate) fn log_prob_without_constant(&self, row: &[f32]) -> f64 {
        let term = |i: usize| {
            let z = self.0.standard(row, i);
            log(self.0.sigma[i]) + 0.5 * z * z
        };
        -self.0.counted().map(term).sum::<f64>()
    }
}

impl Density for DiagonalGaussian {
    fn fit(
        &mut self,
        observations: Observations<'_>,
        _context: DensityContext,
    ) -> Result<(), MarlError> {
        self.0.fit(observations);
        Ok(())
    }

    fn log_prob(
        &self,
        observations: Observations<'_>,
        _context: DensityContext,
    ) -> Result<Vec<f64>, MarlError> {
        let constant = 0.5 * LOG_TWO_PI * self.features().0 as f64;
        Ok(observations.map(|row| self.log_prob_without_constant(row) - constant))
    }

    fn features(&self) -> (usize, usize) {
        self.0.features()
    }

    fn visit(&mut self, prefix: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.0.visit(prefix, visitor)
    }
}

#[cfg(test)]
mod tests {
    use libm::sqrt;
    use policy::randomness::RunSeed;

    use super::*;

    const ONCE: DensityContext =
        DensityContext { seed: RunSeed(0), iteration: 0, agent: 0, query: 0 };

    /// Features: 0 varies, 1 is an agent's index, 2 hardly varies, 3 never varies.
    const ROWS: [f32; 16] = [
        1.0, 1.0, 0.001, 7.0, //
        2.0, 1.0, 0.003, 7.0, //
        3.0, 1.0, 0.001, 7.0, //
        6.0, 1.0, 0.003, 7.0,
    ];

    fn fitted() -> DiagonalGaussian {
        let mut density = DiagonalGaussian(Moments::new(vec![0, 2, 3]));
        density.fit(Observations { data: &ROWS, width: 4 }, ONCE).unwrap();
        density
    }

    fn log_prob(density: &DiagonalGaussian, rows: &[f32]) -> Vec<f64> {
        density.log_prob(Observations { data: rows, width: 4 }, ONCE).unwrap()
    }

    #[test]
    fn a_fit_is_mean_and_standard_deviation_with_a_floor_and_leaves_out_constant_features() {
        let density = fitted().0;
        let spread = sqrt(3.5); // (4 + 1 + 0 + 9) / 4
        assert!((density.mean[0] - 3.0).abs() < 1e-12 && (density.sigma[0] - spread).abs() < 1e-12);
        assert_eq!((density.sigma[1], density.active[1]), (0.01, true)); // 0.001 is below the floor
        assert!(!density.active[2]);
        assert_eq!(density.features(), (2, 1));
    }

    #[test]
    fn the_log_density_matches_a_worked_case_with_and_without_its_constant() {
        let density = fitted();
        // z = 1 and 0.4 in the two active features. The other features have no effect.
        let row = [3.0 + sqrt(3.5) as f32, 9.0, 0.006, 100.0];
        let by_hand = -(0.5 * log(3.5) + 0.5) - (log(0.01) + 0.5 * 0.4 * 0.4);
        assert!((density.log_prob_without_constant(&row) - by_hand).abs() < 1e-6);
        assert!((log_prob(&density, &row)[0] - (by_hand - LOG_TWO_PI)).abs() < 1e-6);
    }

    #[test]
    fn the_fit_maximises_the_likelihood_of_the_rows() {
        let best = fitted();
        let likelihood = |density: &DiagonalGaussian| log_prob(density, &ROWS).iter().sum::<f64>();
        for (by, scale) in [(0.1, 1.0), (-0.1, 1.0), (0.0, 1.1), (0.0, 0.9)] {
            let mut other = best.clone();
            other.0.mean[0] += by;
            other.0.sigma[0] *= scale;
            assert!(likelihood(&other) < likelihood(&best));
        }
    }
}
