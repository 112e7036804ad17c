//! Networks as operations on tensors.
//!
//! In single precision a whole network is one node of the graph, which the crate `kernels` computes forwards and
//! backwards. In double precision, and for the tests of the other, [`plain`] holds the same layers out of candle's own
//! operations.

mod network;
pub mod plain;
mod sigmoid;
mod values;

pub use kernels::{Activation, Layer, Network};
pub use network::{Backward, LayerStack, RecurrentInput, Weights};
pub use sigmoid::sigmoid;

/// Added to a variance before its root, in a layer norm.
pub const LAYER_NORM_EPSILON: f64 = 1e-5;
