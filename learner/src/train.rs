//! Training: the training loop, the batch of an iteration, the states of environments, and evaluations.

pub mod assemble;
pub mod environments;
pub mod evaluation;
pub mod fault;
pub mod trainer;
