//! Densities of one agent's observations (Eq. 2): what surprise is measured against.

pub mod categorical;
pub mod diagonal_gaussian;
mod moments;
mod stored;
#[cfg(test)]
mod tests;
pub mod vae;

use policy::arrays::NamedArrays;
use policy::randomness::RunSeed;
use rayon::prelude::*;

use crate::config::{DensityKind, SurpriseConfig};
use crate::error::MarlError;
use moments::Moments;

/// Observations of one agent.
#[derive(Clone, Copy, Debug)]
pub struct Observations<'a> {
    /// Row after row, `[R, width]`.
    pub data: &'a [f32],
    /// Features of a row, signal or not.
    pub width: usize,
}

impl<'a> Observations<'a> {
    /// All rows.
    pub fn rows(self) -> impl ExactSizeIterator<Item = &'a [f32]> {
        self.data.chunks_exact(self.width)
    }

    /// `R`.
    #[must_use]
    pub fn count(self) -> usize {
        self.data.len() / self.width
    }

    /// One feature of every row.
    pub fn column(self, feature: usize) -> impl Iterator<Item = f32> + 'a {
        self.data.iter().skip(feature).step_by(self.width).copied()
    }

    /// `value` of every row, computed side by side.
    fn map(self, value: impl Fn(&[f32]) -> f64 + Sync + Send) -> Vec<f64> {
        self.data.par_chunks_exact(self.width).map(value).collect()
    }
}

/// When a density is fitted or asked, and by whom: the key of its draws.
#[derive(Clone, Copy, Debug)]
pub struct Occasion {
    /// The run's seed.
    pub seed: RunSeed,
    /// Iteration of the observations.
    pub iteration: u64,
    /// The agent who made them.
    pub agent: u32,
    /// Weight of what the density knew before a fit, in `[0, 1)`; only moments can be weighed so.
    pub memory: f64,
}

/// A density `p_theta` over one agent's observations.
pub trait Density: Send + Sync {
    /// Fits `theta` to the observations by maximum likelihood, or as near as the class comes to it.
    ///
    /// # Errors
    /// Passes on a tensor error.
    fn fit(&mut self, observations: Observations<'_>, occasion: Occasion) -> Result<(), MarlError>;
    /// `log p_theta(o)` of every row after a fit, or an estimate of it, `[R]`, nats.
    ///
    /// # Errors
    /// Passes on a tensor error.
    fn log_prob(
        &self,
        observations: Observations<'_>,
        occasion: Occasion,
    ) -> Result<Vec<f64>, MarlError>;
    /// Features that count, and features that were left out because they hardly vary.
    fn features(&self) -> (usize, usize);
    /// `theta`, and whatever else the next fit depends on, as arrays under `prefix`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    fn arrays(&self, prefix: &str) -> Result<NamedArrays, MarlError>;
    /// Takes over a kept `theta`.
    ///
    /// # Errors
    /// Names the array that is missing or has another shape or type.
    fn restore(&mut self, prefix: &str, arrays: &NamedArrays) -> Result<(), MarlError>;
}

/// The density that `config` asks for, over the observation features `signal` of agent `agent`.
///
/// # Errors
/// Passes on a tensor error.
pub fn build(
    config: &SurpriseConfig,
    signal: &[usize],
    (seed, agent): (RunSeed, u32),
) -> Result<Box<dyn Density>, MarlError> {
    let moments = Moments::new(signal.to_vec(), config.feature_sigma_floor, config.mask_below);
    Ok(match config.density {
        DensityKind::DiagonalGaussian => Box::new(diagonal_gaussian::DiagonalGaussian(moments)),
        DensityKind::Categorical => Box::new(categorical::Categorical::new(moments)),
        DensityKind::Vae => Box::new(vae::Vae::new(&config.vae, moments, (seed, agent))?),
    })
}
