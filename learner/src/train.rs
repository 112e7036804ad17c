//! Training: the training loop, the batch of an iteration, the states of environments, evaluations, and provenance.

pub mod assemble;
pub mod environments;
pub mod evaluation;
pub(crate) mod fail_points;
pub mod prepare;
pub mod provenance;
pub mod reward_terms;
pub mod trainer;
