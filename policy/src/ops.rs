//! Networks as operations on tensors.
//!
//! In single precision a whole network is one node of the graph, computed by the crate `kernels`. In double precision,
//! and as the reference in tests, [`plain`] builds the same layers from candle's own operations.

mod network;
pub mod plain;
mod sigmoid;
mod values;

pub use kernels::{Activation, Layer, Network};
pub use network::{Backward, LayerStack, RecurrentInput, Weights};
pub use sigmoid::sigmoid;

/// Added to the variance in a layer norm, before the square root.
pub const LAYER_NORM_EPSILON: f64 = 1e-5;
