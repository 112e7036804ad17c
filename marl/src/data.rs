//! The rollout data `D_k`: batches, chunked sequences, and scaling of observations.

pub(crate) mod batch;
pub(crate) mod observation;
pub(crate) mod running;
pub(crate) mod sequence;
