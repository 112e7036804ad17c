//! Optimisation: shards of minibatches, gradients, Adam and learning rates.

pub mod gradient;
pub(crate) mod layers;
pub mod learning_rate;
pub mod minibatch;
pub mod optimizer;
pub(crate) mod shards;
#[cfg(test)]
pub(crate) mod tests;
