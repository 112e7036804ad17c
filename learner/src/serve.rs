//! The network: the gRPC services and their clients.

pub mod door;
pub mod health;
pub mod service;
pub(crate) mod team;
