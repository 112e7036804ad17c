//! Nearest neighbours in a fixed random projection: a log-density that is not fitted to anything.

use core::f64::consts::PI;

use libm::{lgamma, log, sqrt};
use policy::arrays::{Array, NamedArrays};
use policy::initialise::orthogonal;
use policy::randomness::{Draw, Purpose, RunSeed, generator};

use super::moments::Moments;
use super::stored;
use crate::config::SurpriseConfig;
use crate::density::{Density, Observations, Occasion};
use crate::error::MarlError;

/// Distances below this, in deviations, are taken for it: rows that occur twice would otherwise have
/// an infinite density.
const SMALLEST_RADIUS: f64 = 1e-3;

/// An orthogonal projection of the standardised features, and a sample of projected rows.
#[derive(Clone, Debug, PartialEq)]
pub struct RandomEncoder {
    moments: Moments,
    neighbours: usize,
    most: usize,
    /// Rows of the projection, `[E, S]` over the `S` signal features.
    projection: Vec<f32>,
    /// The sample, `[M, E]`.
    references: Vec<f64>,
    /// `E`.
    dimensions: usize,
}

impl RandomEncoder {
    /// A projection drawn once for agent `agent`, and no sample yet.
    pub(super) fn new(
        config: &SurpriseConfig,
        moments: Moments,
        (seed, agent): (RunSeed, u32),
    ) -> Self {
        let dimensions = config.embedding.min(moments.signals());
        let mut rng = generator(seed, Draw::of(Purpose::DensityInitialisation).agent(agent));
        let projection = orthogonal(&mut rng, dimensions, moments.signals(), 1.0);
        let (neighbours, most) = (config.neighbours, config.references);
        Self { moments, neighbours, most, projection, references: Vec::new(), dimensions }
    }

    fn encoded(&self, row: &[f32]) -> Vec<f64> {
        let standard: Vec<(usize, f64)> =
            self.moments.counted().map(|i| (i, self.moments.standard(row, i))).collect();
        let along = |weights: &[f32]| -> f64 {
            standard.iter().map(|&(i, x)| f64::from(weights[i]) * x).sum()
        };
        self.projection.chunks_exact(self.moments.signals().max(1)).map(along).collect()
    }

    /// Axes in which a projected row can vary.
    fn rank(&self) -> usize {
        self.dimensions.min(self.moments.features().0)
    }

    /// Kozachenko and Leonenko's `psi(k) - log M - log V_d - d log r_k` with `r_k` the distance to the
    /// `k`-th of `M` neighbours and `V_d` the unit ball's volume, less the mean log-deviation of the
    /// features per axis. Where the projection keeps all features this estimates their log-density;
    /// otherwise that of the projection. A reference at no distance is taken for the row itself.
    fn row(&self, row: &[f32]) -> f64 {
        let rank = self.rank() as f64;
        if rank == 0.0 {
            return 0.0;
        }
        let here = self.encoded(row);
        let distance = |other: &[f64]| -> f64 {
            sqrt(other.iter().zip(&here).map(|(x, y)| (x - y) * (x - y)).sum())
        };
        let mut distances: Vec<f64> =
            self.references.chunks_exact(self.dimensions).map(distance).collect();
        distances.sort_unstable_by(f64::total_cmp);
        let others = &distances[usize::from(distances[0] == 0.0)..];
        let k = self.neighbours.min(others.len()).max(1);
        let radius = others.get(k - 1).copied().unwrap_or(0.0).max(SMALLEST_RADIUS);
        let volume = 0.5 * rank * log(PI) - lgamma(0.5 * rank + 1.0);
        let scale = self.moments.log_volume() / self.features().0 as f64;
        digamma(k) - log(others.len().max(1) as f64) - volume - rank * (log(radius) + scale)
    }
}

/// `psi(k) = -gamma + sum_(j < k) 1 / j`, the mean logarithm of what `k` neighbours fill.
fn digamma(k: usize) -> f64 {
    const EULER: f64 = 0.577_215_664_901_532_9;
    (1..k).map(|j| 1.0 / j as f64).sum::<f64>() - EULER
}

impl Density for RandomEncoder {
    /// Takes the references: at most so many rows, evenly spaced over all.
    fn fit(
        &mut self,
        observations: Observations<'_>,
        _occasion: Occasion,
    ) -> Result<(), MarlError> {
        self.moments.fit(observations, 0.0);
        let (count, width) = (observations.count(), observations.width);
        let kept = count.min(self.most);
        let row = |i: usize| {
            let start = i * count / kept * width;
            self.encoded(&observations.data[start..start + width])
        };
        self.references = (0..kept).flat_map(row).collect();
        Ok(())
    }

    fn log_prob(
        &self,
        observations: Observations<'_>,
        _occasion: Occasion,
    ) -> Result<Vec<f64>, MarlError> {
        Ok(observations.map(|row| self.row(row)))
    }

    fn features(&self) -> (usize, usize) {
        self.moments.features()
    }

    /// Moments and references; the projection follows from the run's seed.
    fn arrays(&self, prefix: &str) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.moments.arrays(prefix);
        let shape = vec![self.references.len() / self.dimensions.max(1), self.dimensions];
        let array = Array::F64 { shape, data: self.references.clone() };
        arrays.insert(format!("{prefix}references"), array);
        Ok(arrays)
    }

    fn restore(&mut self, prefix: &str, arrays: &NamedArrays) -> Result<(), MarlError> {
        let (name, shape) = (format!("{prefix}references"), [None, Some(self.dimensions)]);
        let references = stored::reals(arrays, &name, &shape)?;
        self.moments.restore(prefix, arrays)?;
        self.references = references;
        Ok(())
    }
}
