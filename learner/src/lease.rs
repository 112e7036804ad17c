//! Work leased to actors: slots and leases, published weights, and the exchange between service and trainer.

pub mod canary;
pub mod check;
pub mod end_states;
pub mod exchange;
pub mod published;
pub mod sample;
pub mod slots;
