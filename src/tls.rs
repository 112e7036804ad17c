//! The TLS arguments of servers and clients.

use std::path::PathBuf;

use clap::Args;
use security::{ClientTls, IdentityFiles, ServerTls};

use crate::errors::Usage;

/// TLS files of a server, or permission to do without.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ServerTlsArguments {
    /// Allow a non-loopback --listen address without encryption and authentication.
    #[arg(long, conflicts_with = "tls_certificate")]
    pub(crate) insecure_allow_remote: bool,
    /// Use TLS with this certificate (PEM, followed by its chain) and require a certificate from every client.
    #[arg(long, value_name = "FILE", requires_all = ["tls_key", "tls_client_ca"])]
    tls_certificate: Option<PathBuf>,
    /// Private key of --tls-certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_key: Option<PathBuf>,
    /// Certificate authority that signed the certificates of actors and operators (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_client_ca: Option<PathBuf>,
}

/// TLS files of a learner's client: its certificate and the authority that it trusts.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ClientTlsArguments {
    /// Certificate authority that signed the learner's certificate (PEM); required for an https:// URL.
    #[arg(long, value_name = "FILE", requires_all = ["tls_certificate", "tls_key"])]
    tls_ca: Option<PathBuf>,
    /// This client's certificate (PEM, followed by its chain); its role defines which requests are permitted.
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_certificate: Option<PathBuf>,
    /// Private key of --tls-certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_key: Option<PathBuf>,
    /// Host name in the learner's certificate [default: the host in the URL].
    #[arg(long, value_name = "NAME", requires = "tls_ca")]
    tls_server_name: Option<String>,
}

impl ServerTlsArguments {
    /// Reads the TLS files, if the arguments name them.
    ///
    /// # Errors
    /// A file is invalid.
    pub(crate) fn read(&self) -> Result<Option<ServerTls>, Usage> {
        let own = identity(self.tls_certificate.as_ref(), self.tls_key.as_ref());
        let (Some(own), Some(client_authority)) = (own, &self.tls_client_ca) else {
            return Ok(None);
        };
        let tls = ServerTls::read(&own, client_authority);
        tls.map(Some).map_err(|why| Usage::new(why.to_string()))
    }
}

impl ClientTlsArguments {
    /// Whether the arguments name TLS files.
    pub(crate) fn are_given(&self) -> bool {
        self.tls_ca.is_some()
    }

    /// Reads the TLS files, if the arguments name them.
    ///
    /// # Errors
    /// A file is invalid.
    pub(crate) fn read(&self) -> Result<Option<ClientTls>, Usage> {
        let own = identity(self.tls_certificate.as_ref(), self.tls_key.as_ref());
        let (Some(own), Some(authority)) = (own, &self.tls_ca) else { return Ok(None) };
        let tls = ClientTls::read(&own, authority, self.tls_server_name.clone());
        tls.map(Some).map_err(|why| Usage::new(why.to_string()))
    }
}

/// Reads the TLS files for a request to the learner at `url`; none for plain text.
///
/// # Errors
/// The scheme of `url` and the arguments disagree, or a file is invalid.
pub(crate) fn credentials(url: &str, tls: &ClientTlsArguments) -> Result<Option<ClientTls>, Usage> {
    match (tls.are_given(), url.starts_with("https://")) {
        (false, true) => Err(Usage::new(format!(
            "{url}: https:// needs --tls-ca, --tls-certificate and --tls-key"
        ))),
        (true, false) => Err(Usage::new(format!("{url}: with --tls-ca it begins with https://"))),
        (true, true) | (false, false) => tls.read(),
    }
}

fn identity(certificate: Option<&PathBuf>, key: Option<&PathBuf>) -> Option<IdentityFiles> {
    Some(IdentityFiles { certificate: certificate?.clone(), key: key?.clone() })
}
