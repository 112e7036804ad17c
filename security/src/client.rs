//! The TLS files of clients. They are read for every new connection, so that renewed files take effect with the next
//! connection.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::SystemTime;

use rustls::ClientConfig;
use rustls::pki_types::ServerName;
use rustls::sign::SingleCertAndKey;

use crate::error::SecurityError;
use crate::files::{IdentityFiles, authorities, certified_key, provider, read, unusable};

/// Certificate files of a client, and the server name that it expects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClientFiles {
    /// PEM file of the authority that signed the learner's certificate.
    pub authority: PathBuf,
    /// The client's own certificate and key.
    pub identity: IdentityFiles,
    /// Name in the learner's certificate; `None`: the host in its URL.
    pub server_name: Option<String>,
}

/// The contents of those files in PEM form, valid when they were read.
pub struct ClientCredentials {
    /// Authority of the learner's certificate.
    pub authority: Vec<u8>,
    /// The client's certificate.
    pub certificate: Vec<u8>,
    /// Its private key: a secret.
    pub key: Vec<u8>,
}

impl ClientFiles {
    /// Reads and checks all files.
    ///
    /// # Errors
    /// Names the first invalid file.
    pub fn read(&self) -> Result<ClientCredentials, SecurityError> {
        let credentials = ClientCredentials {
            authority: read(&self.authority)?,
            certificate: read(&self.identity.certificate)?,
            key: read(&self.identity.key)?,
        };
        self.configure(&credentials)?;
        Ok(credentials)
    }

    /// The TLS settings and the expected server name for a handshake with the learner on `host`.
    ///
    /// # Errors
    /// Names the first invalid file, or the invalid server name.
    pub fn handshake(
        &self,
        host: &str,
    ) -> Result<(ClientConfig, ServerName<'static>), SecurityError> {
        let config = self.configure(&self.read()?)?;
        let name = self.server_name.as_deref().unwrap_or(host);
        let server = ServerName::try_from(name.to_owned())
            .map_err(|_| SecurityError::NoName { name: name.to_owned() })?;
        Ok((config, server))
    }

    fn configure(&self, own: &ClientCredentials) -> Result<ClientConfig, SecurityError> {
        let now = SystemTime::now();
        let learners = authorities(&self.authority, &own.authority, now)?;
        let key = certified_key(&self.identity, &own.certificate, &own.key, now)?;
        let config = ClientConfig::builder_with_provider(Arc::new(provider()))
            .with_protocol_versions(&[&rustls::version::TLS13])
            .map_err(|error| unusable(&self.authority, "certificate", error.to_string()))?
            .with_root_certificates(learners)
            .with_client_cert_resolver(Arc::new(SingleCertAndKey::from(key)));
        Ok(config)
    }
}
