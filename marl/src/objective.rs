//! The actors' objective: advantages, HAPPO's surrogate, and the loss of Eq. (10).

pub mod actor_loss;
pub mod advantage;
pub mod surrogate;
