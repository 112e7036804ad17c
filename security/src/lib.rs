//! Who may talk to whom: certificates and the roles they carry, TLS for both ends, and where plain text is
//! allowed. It reads files and knows no socket and no call; [`development`] makes certificates to begin with.

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
