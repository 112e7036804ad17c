//! What an actor shows and whom it trusts. The files are read for every new connection, so that renewed
//! ones are used from the next connection on.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::SystemTime;

use rustls::ClientConfig;
use rustls::pki_types::ServerName;
use rustls::sign::SingleCertAndKey;

use crate::error::SecurityError;
use crate::files::{IdentityFiles, authorities, certified_key, provider, read, unusable};

/// Where a client's certificates are, and whom it expects to find.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClientFiles {
    /// PEM file of the authority that signed the learner's certificate.
    pub authority: PathBuf,
    /// The client's own certificate and key.
    pub identity: IdentityFiles,
    /// Name in the learner's certificate; `None`: the host in its URL.
    pub server_name: Option<String>,
}

/// The contents of those files, in PEM form, good at the moment they were read.
pub struct ClientCredentials {
    /// Authority of the learner's certificate.
    pub authority: Vec<u8>,
    /// The client's certificate.
    pub certificate: Vec<u8>,
    /// Its private key: a secret.
    pub key: Vec<u8>,
}

impl ClientFiles {
    /// Reads and checks all of them.
    ///
    /// # Errors
    /// Names the first file that is wrong.
    pub fn read(&self) -> Result<ClientCredentials, SecurityError> {
        let credentials = ClientCredentials {
            authority: read(&self.authority)?,
            certificate: read(&self.identity.certificate)?,
            key: read(&self.identity.key)?,
        };
        self.configure(&credentials)?;
        Ok(credentials)
    }

    /// What a handshake with the learner on `host` takes: the settings, and the name expected there.
    ///
    /// # Errors
    /// Names the first file that is wrong, or the name if it is none.
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
