//! The arguments that say who may talk to whom.

use std::path::PathBuf;

use clap::Args;
use security::{ClientFiles, IdentityFiles, ServerFiles};

/// How a learner is guarded.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ServerTlsArguments {
    /// Speak TLS with this certificate (PEM, its chain after it), and let in only who shows one, too.
    #[arg(long, value_name = "FILE", requires_all = ["tls_key", "tls_client_ca"])]
    tls_certificate: Option<PathBuf>,
    /// Private key of --tls-certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_key: Option<PathBuf>,
    /// Authority that signed the certificates of actors, viewers and admins (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_client_ca: Option<PathBuf>,
}

/// How a client of a learner shows who it is, and whom it trusts.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ClientTlsArguments {
    /// Authority that signed the learner's certificate (PEM); needed for an https:// URL.
    #[arg(long, value_name = "FILE", requires_all = ["tls_certificate", "tls_key"])]
    tls_ca: Option<PathBuf>,
    /// This client's certificate (PEM, its chain after it); the role in it says what it may ask.
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_certificate: Option<PathBuf>,
    /// Private key of --tls-certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_key: Option<PathBuf>,
    /// Name in the learner's certificate [default: the host in the URL].
    #[arg(long, value_name = "NAME", requires = "tls_ca")]
    tls_server_name: Option<String>,
}

impl ServerTlsArguments {
    /// The files, if there are any.
    pub(crate) fn files(&self) -> Option<ServerFiles> {
        let identity = identity(self.tls_certificate.as_ref(), self.tls_key.as_ref())?;
        Some(ServerFiles { identity, client_authority: self.tls_client_ca.clone()? })
    }
}

impl ClientTlsArguments {
    /// The files, if there are any.
    pub(crate) fn files(&self) -> Option<ClientFiles> {
        let identity = identity(self.tls_certificate.as_ref(), self.tls_key.as_ref())?;
        let server_name = self.tls_server_name.clone();
        Some(ClientFiles { authority: self.tls_ca.clone()?, identity, server_name })
    }
}

fn identity(certificate: Option<&PathBuf>, key: Option<&PathBuf>) -> Option<IdentityFiles> {
    Some(IdentityFiles { certificate: certificate?.clone(), key: key?.clone() })
}
