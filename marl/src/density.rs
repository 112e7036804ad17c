//! Densities of one agent's observations (Eq. 2), which define surprise.

pub(crate) mod categorical;
pub(crate) mod diagonal_gaussian;
mod moments;
pub(crate) mod random_encoder;
#[cfg(test)]
mod tests;
pub(crate) mod vae;

use policy::randomness::RunSeed;
use rayon::prelude::*;

use crate::config::DensityKind;
use crate::distribution::gaussian::LOG_TWO_PI;
use crate::error::MarlError;
use crate::shape::assert_shape;
use crate::state::Visitor;
use moments::Moments;

/// Observations of one agent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observations<'a> {
    /// Values, row-major, `[R, width]`.
    pub data: &'a [f32],
    /// Features per row, including those that are not scored.
    pub width: usize,
}

impl<'a> Observations<'a> {
    /// All rows.
    pub(crate) fn rows(self) -> impl ExactSizeIterator<Item = &'a [f32]> {
        self.data.chunks_exact(self.width)
    }

    /// Number of rows, `R`.
    ///
    /// # Panics
    /// If the values are not whole rows.
    pub(crate) fn count(self) -> usize {
        let rows = self.data.len() / self.width;
        assert_shape("observations", self.data.len(), rows * self.width);
        rows
    }

    /// Values of one feature in all rows.
    pub(crate) fn column(self, feature: usize) -> impl Iterator<Item = f32> + 'a {
        self.data.iter().skip(feature).step_by(self.width).copied()
    }

    /// `value` of every row, computed in parallel.
    fn map(self, value: impl Fn(&[f32]) -> f64 + Sync + Send) -> Vec<f64> {
        let mut values = Vec::with_capacity(self.count());
        self.data.par_chunks_exact(self.width).map(value).collect_into_vec(&mut values);
        values
    }
}

/// Key of the random draws of a fit or a query.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DensityContext {
    /// The run's seed.
    pub seed: RunSeed,
    /// Iteration of the observations.
    pub iteration: u64,
    /// Index of the agent.
    pub agent: u32,
    /// 0 for the observations of the fit; 1 + the optimiser step for which others are drawn from a replay.
    pub query: u32,
}

/// A density `p_theta` over one agent's observations.
pub(crate) trait Density: Send + Sync {
    /// Fits `theta` to the observations by maximum likelihood, or by an approximation of it.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn fit(
        &mut self,
        observations: Observations<'_>,
        context: DensityContext,
    ) -> Result<(), MarlError>;
    /// `log p_theta(o)` of every row, or an estimate of it, `[R]`, nats. Needs a fit.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn log_prob(
        &self,
        observations: Observations<'_>,
        context: DensityContext,
    ) -> Result<Vec<f64>, MarlError>;
    /// Number of active features of the density, and of features left out because they hardly vary.
    fn features(&self) -> (usize, usize);
    /// The constant that the score adds to the log-density, nats: `1/2 log 2 pi` per active feature, which Eq. (4)
    /// omits.
    fn omitted_constant(&self) -> f64 {
        0.5 * LOG_TWO_PI * self.features().0 as f64
    }
    /// Visits `theta`, the state from which the next fit continues, and figures of the last fit that the hash of the
    /// state covers, as arrays under `prefix`.
    ///
    /// # Errors
    /// Passes on the visitor's; if a tensor operation fails.
    fn visit(&mut self, prefix: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError>;
}

/// A density of this kind over the observation features `signal` of agent `agent`.
///
/// # Errors
/// If a tensor operation fails.
pub(crate) fn build(
    kind: DensityKind,
    signal: &[usize],
    (seed, agent): (RunSeed, u32),
) -> Result<Box<dyn Density>, MarlError> {
    let moments = Moments::new(signal.to_vec());
    // Without features every density is 1, and a network has no input.
    let kind = if signal.is_empty() { DensityKind::DiagonalGaussian } else { kind };
    Ok(match kind {
        DensityKind::DiagonalGaussian => Box::new(diagonal_gaussian::DiagonalGaussian(moments)),
        DensityKind::Categorical => Box::new(categorical::CategoricalDensity::new(moments)),
        DensityKind::RandomEncoder => {
            Box::new(random_encoder::RandomEncoder::new(signal.to_vec(), (seed, agent))?)
        }
        DensityKind::Vae => Box::new(vae::Vae::new(vae::CONFIG, moments, (seed, agent))?),
    })
}
