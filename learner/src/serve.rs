//! The gRPC services and their clients.

pub mod health;
pub mod listener;
pub mod service;
pub(crate) mod team;
