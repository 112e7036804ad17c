//! The rollout data `D_k`: batches, chunked sequences, and scaling of observations.

pub mod batch;
pub mod observation;
pub mod running;
pub mod sequence;
