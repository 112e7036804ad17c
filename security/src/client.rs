//! TLS of a learner's clients.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use rustls::ClientConfig;
use rustls::pki_types::{ServerName, UnixTime};
use rustls::sign::SingleCertAndKey;

use crate::error::SecurityError;
use crate::files::{IdentityFiles, Purpose, authorities, certified_key, provider, read, unusable};

/// The certificates of a client, in PEM form, which were valid when they were read.
#[derive(Clone)]
pub struct ClientTls {
    /// Authority of the learner's certificate.
    pub authority: Vec<u8>,
    /// The client's certificate and its chain.
    pub certificate: Vec<u8>,
    /// Its private key: a secret.
    pub key: Vec<u8>,
    /// Name in the learner's certificate; `None`: the host in its URL.
    pub server_name: Option<String>,
    config: Arc<ClientConfig>,
}

impl ClientTls {
    /// Reads and checks the client's own files and the file of the authority that signed the learner's certificate.
    ///
    /// # Errors
    /// Names the first invalid file, or the invalid server name.
    pub fn read(
        own: &IdentityFiles,
        authority: &Path,
        server_name: Option<String>,
    ) -> Result<Self, SecurityError> {
        if let Some(name) = &server_name {
            ServerName::try_from(name.as_str()).map_err(|_| {
                SecurityError(format!("`{name}` is neither a host name nor an IP address"))
            })?;
        }
        let now = UnixTime::now();
        let trusted = read(authority)?;
        let certificate = read(&own.certificate)?;
        let key = read(&own.key)?;
        let learners = authorities(authority, &trusted, now)?;
        let pair = certified_key(own, &certificate, &key, Purpose::Client, now)?;
        let config = ClientConfig::builder_with_provider(Arc::new(provider()))
            .with_protocol_versions(&[&rustls::version::TLS13])
            .map_err(|error| unusable(authority, "certificate", error.to_string()))?
            .with_root_certificates(learners)
            .with_client_cert_resolver(Arc::new(SingleCertAndKey::from(pair)));
        Ok(Self { authority: trusted, certificate, key, server_name, config: Arc::new(config) })
    }

    /// The TLS settings and the expected server name for a handshake with the learner on `host`; `None` if `host` is
    /// neither a host name nor an IP address.
    #[must_use]
    pub fn handshake(&self, host: &str) -> Option<(Arc<ClientConfig>, ServerName<'static>)> {
        let name = self.server_name.as_deref().unwrap_or(host).to_owned();
        Some((Arc::clone(&self.config), ServerName::try_from(name).ok()?))
    }
}

impl fmt::Debug for ClientTls {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("ClientTls").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use rustls::RootCertStore;

    use super::*;

    #[test]
    fn the_debug_form_shows_no_key() {
        let config = ClientConfig::builder_with_provider(Arc::new(provider()))
            .with_protocol_versions(&[&rustls::version::TLS13])
            .unwrap()
            .with_root_certificates(RootCertStore::empty())
            .with_no_client_auth();
        let tls = ClientTls {
            authority: b"authority".to_vec(),
            certificate: b"certificate".to_vec(),
            key: b"key".to_vec(),
            server_name: None,
            config: Arc::new(config),
        };
        assert_eq!(format!("{tls:?}"), "ClientTls { .. }");
    }
}
