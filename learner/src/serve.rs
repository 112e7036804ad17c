//! The gRPC services and their clients.

pub(crate) mod accepting;
pub mod health;
pub mod listener;
pub mod service;
pub(crate) mod team;
pub(crate) mod token;
