//! The gRPC services and their clients, and the web page.

pub(crate) mod accepting;
pub mod client;
pub mod listener;
pub mod page;
pub mod service;
