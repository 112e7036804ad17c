//! Optimisation: shards of minibatches, gradients, Adam and learning rates.

pub(crate) mod gradient;
pub(crate) mod layers;
pub(crate) mod learning_rate;
pub(crate) mod minibatch;
pub(crate) mod optimizer;
pub(crate) mod shards;
#[cfg(test)]
pub(crate) mod tests;
