//! Fused operations with backward passes written by hand, and their plain twins.
//!
//! A network of plain candle operations spends most of its time between matrix products. These
//! operations do a layer each: one pass forward, one backward, no intermediate tensors. They run on
//! the CPU in single and double precision; [`plain`] holds the same functions out of candle's own
//! operations, as oracle of the tests and for other devices.

mod gru;
mod layer_norm;
mod linear;
pub mod plain;
mod product;
mod sigmoid;
mod values;

pub use gru::gru_sequence;
pub use layer_norm::layer_norm;
pub use linear::linear;
pub use sigmoid::sigmoid;

/// Added to a variance before its root, in [`layer_norm`].
pub const LAYER_NORM_EPSILON: f64 = 1e-5;

/// What follows a linear map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// Hyperbolic tangent.
    Tanh,
    /// `max(x, 0)`.
    Relu,
}
