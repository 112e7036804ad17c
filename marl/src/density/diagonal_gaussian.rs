//! An independent Gaussian per observation feature, as in the paper's experiments.

use libm::{log, sqrt};
use policy::arrays::{Array, NamedArrays};

use crate::config::Constant;
use crate::density::Density;
use crate::error::MarlError;
use crate::gaussian::LOG_TWO_PI;

/// Mean and deviation of every signal feature. A feature whose deviation on `D_k` is below the mask
/// carries no surprise and is left out; the others' deviations are held above the floor.
#[derive(Clone, Debug, PartialEq)]
pub struct DiagonalGaussian {
    signal: Vec<usize>,
    sigma_floor: f64,
    mask_below: f64,
    mean: Vec<f64>,
    sigma: Vec<f64>,
    active: Vec<bool>,
}

impl DiagonalGaussian {
    /// An unfitted density over the features `signal`; floor and mask in units of the feature.
    #[must_use]
    pub fn new(signal: Vec<usize>, sigma_floor: f64, mask_below: f64) -> Self {
        let count = signal.len();
        let (mean, sigma, active) = (vec![0.0; count], vec![1.0; count], vec![false; count]);
        Self { signal, sigma_floor, mask_below, mean, sigma, active }
    }

    /// Indices into `signal` of the features that count.
    fn counted(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.signal.len()).filter(|&i| self.active[i])
    }

    /// Eq. (4): `- sum_j (log sigma_j + (o_j - mu_j)^2 / (2 sigma_j^2))` over the features that
    /// count: the log-density without `-1/2 log 2 pi` per feature. `row` is `[obs]`; nats.
    #[must_use]
    pub fn log_prob_without_constant(&self, row: &[f32]) -> f64 {
        let term = |i: usize| {
            let z = (f64::from(row[self.signal[i]]) - self.mean[i]) / self.sigma[i];
            log(self.sigma[i]) + 0.5 * z * z
        };
        -self.counted().map(term).sum::<f64>()
    }
}

impl Density for DiagonalGaussian {
    /// Sample mean and deviation (the likelihood's maximum divides by `R`), in two passes.
    fn fit(&mut self, rows: &[f32], width: usize) {
        let count = (rows.len() / width) as f64;
        for (i, &feature) in self.signal.iter().enumerate() {
            let column = || rows.iter().skip(feature).step_by(width).map(|&x| f64::from(x));
            let mean = column().sum::<f64>() / count;
            let sigma = sqrt(column().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count);
            self.mean[i] = mean;
            self.active[i] = sigma >= self.mask_below;
            self.sigma[i] = sigma.max(self.sigma_floor);
        }
    }

    fn log_prob(&self, row: &[f32]) -> f64 {
        self.log_prob_without_constant(row) - self.offset(Constant::Paper)
    }

    fn offset(&self, constant: Constant) -> f64 {
        let normalisation = 0.5 * LOG_TWO_PI * self.counted().count() as f64;
        match constant {
            Constant::Density => 0.0,
            Constant::Paper => normalisation,
            // Minus the mean at the fit: what is left is -1/2 sum (z^2 - 1).
            Constant::Centered => {
                normalisation + self.counted().map(|i| log(self.sigma[i]) + 0.5).sum::<f64>()
            }
        }
    }

    fn features(&self) -> (usize, usize) {
        let counted = self.counted().count();
        (counted, self.signal.len() - counted)
    }

    fn arrays(&self, prefix: &str) -> NamedArrays {
        let shape = vec![self.signal.len()];
        let active = self.active.iter().map(|&a| u8::from(a)).collect();
        NamedArrays::from([
            (format!("{prefix}mean"), Array::F64 { shape: shape.clone(), data: self.mean.clone() }),
            (
                format!("{prefix}sigma"),
                Array::F64 { shape: shape.clone(), data: self.sigma.clone() },
            ),
            (format!("{prefix}active"), Array::U8 { shape, data: active }),
        ])
    }

    fn restore(&mut self, prefix: &str, arrays: &NamedArrays) -> Result<(), MarlError> {
        let count = self.signal.len();
        let wrong =
            |name: &str| MarlError::Restore(format!("{name} is not {count} numbers or missing"));
        let real = |name: String| match arrays.get(&name) {
            Some(Array::F64 { data, .. }) if data.len() == count => Ok(data.clone()),
            _ => Err(wrong(&name)),
        };
        let (mean, sigma) = (real(format!("{prefix}mean"))?, real(format!("{prefix}sigma"))?);
        let name = format!("{prefix}active");
        let active = match arrays.get(&name) {
            Some(Array::U8 { data, .. }) if data.len() == count => {
                data.iter().map(|&a| a == 1).collect()
            }
            _ => return Err(wrong(&name)),
        };
        (self.mean, self.sigma, self.active) = (mean, sigma, active);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Features: 0 varies, 1 is a number of the agent, 2 hardly varies, 3 never does.
    const ROWS: [f32; 16] = [
        1.0, 1.0, 0.001, 7.0, //
        2.0, 1.0, 0.003, 7.0, //
        3.0, 1.0, 0.001, 7.0, //
        6.0, 1.0, 0.003, 7.0,
    ];

    fn fitted() -> DiagonalGaussian {
        let mut density = DiagonalGaussian::new(vec![0, 2, 3], 0.01, 1e-4);
        density.fit(&ROWS, 4);
        density
    }

    fn mean_of_rows(value: impl Fn(&[f32]) -> f64) -> f64 {
        ROWS.chunks_exact(4).map(value).sum::<f64>() / 4.0
    }

    #[test]
    fn a_fit_is_mean_and_deviation_with_a_floor_and_leaves_out_what_never_varies() {
        let density = fitted();
        let spread = sqrt(3.5); // (4 + 1 + 0 + 9) / 4
        assert!((density.mean[0] - 3.0).abs() < 1e-12 && (density.sigma[0] - spread).abs() < 1e-12);
        assert_eq!((density.sigma[1], density.active[1]), (0.01, true)); // 0.001 is below the floor
        assert!(!density.active[2]);
        assert_eq!(density.features(), (2, 1));
    }

    #[test]
    fn the_log_density_meets_a_hand_worked_case_with_and_without_its_constant() {
        let density = fitted();
        // z = 1 and 0.4 in the two features that count; the others' values make no difference.
        let row = [3.0 + sqrt(3.5) as f32, 9.0, 0.006, 100.0];
        let by_hand = -(0.5 * log(3.5) + 0.5) - (log(0.01) + 0.5 * 0.4 * 0.4);
        assert!((density.log_prob_without_constant(&row) - by_hand).abs() < 1e-6);
        assert!((density.log_prob(&row) - (by_hand - LOG_TWO_PI)).abs() < 1e-6);
    }

    #[test]
    fn no_other_mean_or_deviation_makes_the_rows_likelier() {
        let best = fitted();
        let likelihood = |density: &DiagonalGaussian| mean_of_rows(|row| density.log_prob(row));
        for (by, scale) in [(0.1, 1.0), (-0.1, 1.0), (0.0, 1.1), (0.0, 0.9)] {
            let mut other = best.clone();
            other.mean[0] += by;
            other.sigma[0] *= scale;
            assert!(likelihood(&other) < likelihood(&best));
        }
    }

    #[test]
    fn constants_differ_by_a_constant_and_the_centred_one_pays_nothing_on_average() {
        let density = fitted();
        let offset = |constant| density.offset(constant);
        assert_eq!(offset(Constant::Density), 0.0);
        assert!((offset(Constant::Paper) - LOG_TWO_PI).abs() < 1e-12); // two features count
        let mut free = DiagonalGaussian::new(vec![0], 0.01, 1e-4);
        free.fit(&ROWS, 4);
        let centred = |row: &[f32]| free.log_prob(row) + free.offset(Constant::Centered);
        assert!(mean_of_rows(centred).abs() < 1e-9);
    }

    #[test]
    fn a_kept_density_is_the_density() {
        let density = fitted();
        let kept = density.arrays("density/agent_0.");
        let mut other = DiagonalGaussian::new(vec![0, 2, 3], 0.01, 1e-4);
        other.restore("density/agent_0.", &kept).unwrap();
        assert_eq!(other, density);
        let error = other.restore("density/agent_1.", &kept).unwrap_err();
        assert!(error.to_string().contains("density/agent_1.mean"), "{error}");
    }
}
