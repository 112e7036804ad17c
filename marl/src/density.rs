//! Densities of one agent's observations (Eq. 2): what surprise is measured against.

pub mod diagonal_gaussian;

use policy::arrays::NamedArrays;

use crate::config::{Constant, DensityKind, SurpriseConfig};
use crate::error::MarlError;

/// A density `p_theta` over one agent's observations.
pub trait Density: Send + Sync {
    /// Fits `theta` to the rows `[R, width]` by maximum likelihood.
    fn fit(&mut self, rows: &[f32], width: usize);
    /// `log p_theta(o)` of one row `[width]`, nats; 0 before the first fit.
    fn log_prob(&self, row: &[f32]) -> f64;
    /// What the reward adds to `log p_theta`, nats: constant within an iteration.
    fn offset(&self, constant: Constant) -> f64;
    /// Features that count, and features that were left out because they hardly vary.
    fn features(&self) -> (usize, usize);
    /// `theta` as arrays under `prefix`.
    fn arrays(&self, prefix: &str) -> NamedArrays;
    /// Takes over a kept `theta`.
    ///
    /// # Errors
    /// Names the array that is missing or has another shape or type.
    fn restore(&mut self, prefix: &str, arrays: &NamedArrays) -> Result<(), MarlError>;
}

/// The density that `config` asks for, over the observation features `signal`.
#[must_use]
pub fn build(config: &SurpriseConfig, signal: &[usize]) -> Box<dyn Density> {
    match config.density {
        DensityKind::DiagonalGaussian => Box::new(diagonal_gaussian::DiagonalGaussian::new(
            signal.to_vec(),
            config.sigma_floor,
            config.mask_below,
        )),
    }
}
