//! From complete slots to new weights: the training loop, the batch, the environments' states, and evaluations.

pub mod assemble;
pub mod environments;
pub mod evaluation;
pub mod fault;
pub mod trainer;
