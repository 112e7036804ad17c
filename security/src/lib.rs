//! Authentication and authorisation: certificates and their roles, TLS for both ends, and the rules for plain text. The
//! crate reads files and uses no sockets; [`development`] creates certificates.

pub mod addresses;
pub mod client;
pub mod development;
pub mod error;
pub mod explanation;
mod files;
pub mod role;
pub mod server;
mod validity;

pub use client::{ClientCredentials, ClientFiles};
pub use error::SecurityError;
pub use explanation::explain;
pub use files::IdentityFiles;
pub use role::{Denied, Role, Standing};
pub use server::{ServerFiles, ServerTls};
