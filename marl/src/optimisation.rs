//! Optimisation: shards of minibatches, gradients in the network's precision, Adam and learning rates.

pub mod gradient;
pub(crate) mod layers;
pub mod learning_rate;
pub mod minibatch;
pub mod optimizer;
pub mod reals;
pub(crate) mod shards;
