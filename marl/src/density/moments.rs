//! Mean and standard deviation of every signal feature: the parameters of a Gaussian, and the units of the other
//! densities.

use libm::{log, sqrt};

use crate::density::Observations;
use crate::error::MarlError;
use crate::state::{ArrayShape, Elements, Visitor, visit_numbers};

/// Lower bound of a feature's standard deviation, in units of the feature. Without it, a feature that hardly varies would
/// dominate the log-density.
const SIGMA_FLOOR: f64 = 0.01;
/// A feature with a smaller standard deviation, in units of the feature, is constant but for rounding.
const MASK_BELOW: f64 = 1e-4;

/// Moments of the signal features. A feature with a standard deviation below the mask is left out. Those of the others
/// are at least the floor.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moments {
    signal: Vec<usize>,
    pub(super) mean: Vec<f64>,
    /// Without the floor that `sigma` has. Only `sigma` is read after a fit; this is stored because the hash of the state
    /// covers it.
    variance: Vec<f64>,
    pub(super) sigma: Vec<f64>,
    pub(super) active: Vec<bool>,
}

impl Moments {
    /// Moments without rows, of the features `signal`.
    pub(super) fn new(signal: Vec<usize>) -> Self {
        let count = signal.len();
        let mean = vec![0.0; count];
        let variance = vec![1.0; count];
        let sigma = vec![1.0; count];
        let active = vec![false; count];
        Self { signal, mean, variance, sigma, active }
    }

    /// Mean and maximum-likelihood standard deviation (divided by `R`), in two passes.
    pub(super) fn fit(&mut self, observations: Observations<'_>) {
        let count = observations.count() as f64;
        for (i, &feature) in self.signal.iter().enumerate() {
            let column = || observations.column(feature).map(f64::from);
            let mean = column().sum::<f64>() / count;
            self.mean[i] = mean;
            self.variance[i] = column().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count;
            let sigma = sqrt(self.variance[i]);
            self.active[i] = sigma >= MASK_BELOW;
            self.sigma[i] = sigma.max(SIGMA_FLOOR);
        }
    }

    /// Number of signal features.
    pub(super) fn signals(&self) -> usize {
        self.signal.len()
    }

    /// Index of the signal feature in an observation.
    pub(super) fn feature(&self, signal: usize) -> usize {
        self.signal[signal]
    }

    /// Active signal features, in order.
    pub(super) fn counted(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.signal.len()).filter(|&i| self.active[i])
    }

    /// `(o_j - mu_j) / sigma_j` of the signal feature `i`.
    pub(super) fn standard(&self, row: &[f32], i: usize) -> f64 {
        (f64::from(row[self.signal[i]]) - self.mean[i]) / self.sigma[i]
    }

    /// Lower bound of the standard deviation of signal feature `i`, in units of its own, at most 1.
    pub(super) fn floor(&self, i: usize) -> f64 {
        SIGMA_FLOOR / self.sigma[i]
    }

    /// `sum_j log sigma_j` over active features: the log-density of standardised features minus that of the features,
    /// nats.
    pub(super) fn log_volume(&self) -> f64 {
        self.counted().map(|i| log(self.sigma[i])).sum()
    }

    /// Number of active features and of features left out.
    pub(super) fn features(&self) -> (usize, usize) {
        let counted = self.counted().count();
        (counted, self.signal.len() - counted)
    }

    pub(super) fn visit(
        &mut self,
        prefix: &str,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        visit_numbers(visitor, &format!("{prefix}mean"), &mut self.mean)?;
        visit_numbers(visitor, &format!("{prefix}variance"), &mut self.variance)?;
        visit_numbers(visitor, &format!("{prefix}sigma"), &mut self.sigma)?;
        let mut active: Vec<i64> = self.active.iter().map(|&a| i64::from(a)).collect();
        let name = format!("{prefix}active");
        let shape = [active.len()];
        visitor.array(&name, ArrayShape::Fixed(&shape), Elements::I64(&mut active))?;
        self.active = active.into_iter().map(|a| a == 1).collect();
        Ok(())
    }
}
