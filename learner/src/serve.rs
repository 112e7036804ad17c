//! The gRPC services and their clients, and the web page.

pub(crate) mod accepting;
pub mod health;
pub mod listener;
pub mod page;
pub(crate) mod served_agents;
pub mod service;
pub(crate) mod token;
