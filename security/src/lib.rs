//! Authentication and authorisation: certificates and their roles, TLS for both ends, and the rules for plain text. The
//! crate reads files and uses no sockets; [`development`] creates certificates.

pub mod addresses;
pub mod client;
pub mod development;
pub mod error;
mod expiries;
pub mod explanation;
mod files;
pub mod role;
pub mod server;
pub mod token;
mod validity;

pub use client::{ClientCredentials, ClientFiles};
pub use error::SecurityError;
pub use expiries::ClientExpiry;
pub use explanation::explain;
pub use files::IdentityFiles;
pub use role::{Denied, Role, Standing};
pub use server::{ServerFiles, ServerTls};
pub use token::Token;
