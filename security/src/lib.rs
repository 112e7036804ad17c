//! Authentication and authorisation: certificates and their roles, TLS for both ends, tokens, and the rules for plain text.
//! The crate reads files and uses no sockets; [`development`] creates certificates.

pub mod addresses;
mod client;
pub mod development;
mod error;
mod explanation;
mod files;
mod role;
mod server;
mod token;

pub use client::ClientTls;
pub use error::SecurityError;
pub use explanation::{explain, explain_rejection};
pub use files::IdentityFiles;
pub use role::{Denied, Permissions, Role};
pub use server::ServerTls;
pub use token::Token;
