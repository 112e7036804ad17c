//! The rollout data `D_k`: as the learner receives it, cut into sequences, and with observations scaled.

pub mod batch;
pub mod observation;
pub mod running;
pub mod sequence;
