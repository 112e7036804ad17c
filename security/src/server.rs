//! TLS of a learner: version 1.3, with a certificate required from every client.

use std::path::Path;
use std::sync::Arc;

use rustls::ServerConfig;
use rustls::pki_types::UnixTime;
use rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use rustls::sign::SingleCertAndKey;

use crate::error::SecurityError;
use crate::files::{
    IdentityFiles, Purpose, certified_key, client_authorities, provider, read, unusable,
};

/// ALPN name of the protocol of all gRPC calls.
const HTTP_2: &[u8] = b"h2";
/// ALPN name of the protocol of the run's page.
const HTTP_1: &[u8] = b"http/1.1";

/// The TLS settings of a listener.
#[derive(Clone, Debug)]
pub struct ServerTls(Arc<ServerConfig>);

impl ServerTls {
    /// Reads and checks the learner's own files and the file of the authority that signed the certificates of clients.
    /// The settings are those of a gRPC listener.
    ///
    /// # Errors
    /// Names the first invalid file.
    pub fn read(own: &IdentityFiles, client_authority: &Path) -> Result<Self, SecurityError> {
        let now = UnixTime::now();
        let pair =
            certified_key(own, &read(&own.certificate)?, &read(&own.key)?, Purpose::Server, now)?;
        let clients = client_authorities(client_authority, &read(client_authority)?, now)?;
        let provider = Arc::new(provider());
        let refused = |error: &dyn std::error::Error, path: &Path| {
            unusable(path, "certificate", error.to_string())
        };
        let verifier =
            WebPkiClientVerifier::builder_with_provider(Arc::new(clients), Arc::clone(&provider))
                .build()
                .map_err(|error| refused(&error, client_authority))?;
        let mut config = ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&rustls::version::TLS13])
            .map_err(|error| refused(&error, &own.certificate))?
            .with_client_cert_verifier(verifier)
            .with_cert_resolver(Arc::new(SingleCertAndKey::from(pair)));
        config.alpn_protocols = vec![HTTP_2.to_vec()];
        // A resumed session would remain valid after the client's certificate has expired.
        config.session_storage = Arc::new(NoServerSessionStorage {});
        config.send_tls13_tickets = 0;
        Ok(Self(Arc::new(config)))
    }

    /// The settings of a listener for the run's page, with the same certificates.
    #[must_use]
    pub fn for_page(&self) -> Self {
        let mut config = ServerConfig::clone(&self.0);
        config.alpn_protocols = vec![HTTP_1.to_vec()];
        Self(Arc::new(config))
    }

    /// The settings for a handshake.
    #[must_use]
    pub fn config(&self) -> Arc<ServerConfig> {
        Arc::clone(&self.0)
    }
}
