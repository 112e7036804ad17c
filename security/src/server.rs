//! TLS of the learner: version 1.3, with a certificate required from every client. Changed files are reloaded without a
//! restart, and an own certificate that expires is reported.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant, SystemTime};

use rustls::ServerConfig;
use rustls::pki_types::CertificateDer;
use rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use rustls::sign::SingleCertAndKey;

use crate::error::SecurityError;
use crate::expiries::{ClientExpiry, Expiries};
use crate::files::{
    IdentityFiles, authorities, certified_key, demand_validity, provider, read, unusable,
};
use crate::validity::Moment;

/// Shortest interval between two checks of the files.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// ALPN name of the protocol of all gRPC calls.
const HTTP_2: &[u8] = b"h2";
/// ALPN name of the protocol of the run's page.
const HTTP_1: &[u8] = b"http/1.1";

/// Certificate files of a learner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerFiles {
    /// The learner's own certificate and key.
    pub identity: IdentityFiles,
    /// PEM file of the authority that signed the clients' certificates.
    pub client_authority: PathBuf,
}

/// The newest valid certificates of a learner.
#[derive(Debug)]
pub struct ServerTls {
    files: ServerFiles,
    state: Mutex<State>,
    clients: Arc<Expiries>,
}

#[derive(Debug)]
struct State {
    config: Arc<ServerConfig>,
    /// End of the validity of the own certificate.
    expires: Moment,
    /// Whether that has been reported.
    expired: bool,
    seen: Result<Contents, SecurityError>,
    looked: Instant,
}

/// Contents of the files.
#[derive(PartialEq, Eq)]
struct Contents {
    certificate: Vec<u8>,
    key: Vec<u8>,
    client_authority: Vec<u8>,
}

impl std::fmt::Debug for Contents {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Contents").finish_non_exhaustive()
    }
}

impl ServerTls {
    /// Reads and checks the files.
    ///
    /// # Errors
    /// Names the first invalid file.
    pub fn open(files: ServerFiles) -> Result<Self, SecurityError> {
        let contents = Contents::read(&files)?;
        let (config, expires) = configure(&files, &contents)?;
        let seen = Ok(contents);
        let state = State { config, expires, expired: false, seen, looked: Instant::now() };
        Ok(Self { files, state: Mutex::new(state), clients: Arc::default() })
    }

    /// The TLS settings of a connection that starts at `now`. Reads the files unless they were read within the last two
    /// seconds. Invalid files are logged once and change nothing; so is the end of the own certificate's validity.
    pub fn config(&self, now: Instant) -> Arc<ServerConfig> {
        let mut state = self.state();
        if now.saturating_duration_since(state.looked) >= LOOK_AGAIN {
            state.looked = now;
            let found = Contents::read(&self.files);
            if found != state.seen {
                state.take_up(&self.files, found);
            }
            state.report_expiry(&self.files.identity.certificate, SystemTime::now().into());
        }
        Arc::clone(&state.config)
    }

    /// The same for a connection with the run's page, which is HTTP/1.1.
    pub fn page_config(&self, now: Instant) -> Arc<ServerConfig> {
        let mut config = ServerConfig::clone(&self.config(now));
        config.alpn_protocols = vec![HTTP_1.to_vec()];
        Arc::new(config)
    }

    /// When the own certificate expires, in seconds since 1970.
    #[must_use]
    pub fn expires(&self) -> Option<i64> {
        self.state().expires.unix_secs()
    }

    /// When the first certificate of all connected clients expires, in seconds since 1970; `None` without clients.
    #[must_use]
    pub fn clients_expire(&self) -> Option<i64> {
        self.clients.earliest()
    }

    /// Counts a connection whose client presented this chain, its own certificate first, until the result is dropped.
    #[must_use]
    pub fn count_client(&self, chain: Option<&[CertificateDer<'_>]>) -> Option<ClientExpiry> {
        self.clients.count(chain)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no thread panics while it holds this lock")
    }
}

impl State {
    fn take_up(&mut self, files: &ServerFiles, found: Result<Contents, SecurityError>) {
        let new = match &found {
            Ok(contents) => configure(files, contents),
            Err(error) => Err(error.clone()),
        };
        match new {
            Ok((config, expires)) => {
                (self.config, self.expires, self.expired) = (config, expires, false);
                tracing::info!("new connections are served with the changed certificates");
            }
            Err(error) => tracing::warn!("the previous certificates stay in use: {error}"),
        }
        self.seen = found;
    }

    fn report_expiry(&mut self, path: &Path, now: Moment) {
        if now > self.expires && !std::mem::replace(&mut self.expired, true) {
            tracing::error!(
                "the certificate {} expired at {}: clients refuse new connections until it is renewed; open \
                 connections remain",
                path.display(),
                self.expires
            );
        }
    }
}

impl Contents {
    fn read(files: &ServerFiles) -> Result<Self, SecurityError> {
        Ok(Self {
            certificate: read(&files.identity.certificate)?,
            key: read(&files.identity.key)?,
            client_authority: read(&files.client_authority)?,
        })
    }
}

/// The TLS settings with these files, and when the own certificate expires.
fn configure(
    files: &ServerFiles,
    contents: &Contents,
) -> Result<(Arc<ServerConfig>, Moment), SecurityError> {
    let now = SystemTime::now();
    let own = certified_key(&files.identity, &contents.certificate, &contents.key, now)?;
    let expires = demand_validity(&files.identity.certificate, &own.cert[0], now)?;
    let clients = authorities(&files.client_authority, &contents.client_authority, now)?;
    let provider = Arc::new(provider());
    let refused = |error: &dyn std::error::Error, path: &Path| {
        unusable(path, "certificate", error.to_string())
    };
    let verifier =
        WebPkiClientVerifier::builder_with_provider(Arc::new(clients), Arc::clone(&provider))
            .build()
            .map_err(|error| refused(&error, &files.client_authority))?;
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(|error| refused(&error, &files.identity.certificate))?
        .with_client_cert_verifier(verifier)
        .with_cert_resolver(Arc::new(SingleCertAndKey::from(own)));
    config.alpn_protocols = vec![HTTP_2.to_vec()];
    // A resumed session would remain valid after its authority was removed.
    config.session_storage = Arc::new(NoServerSessionStorage {});
    config.send_tls13_tickets = 0;
    Ok((Arc::new(config), expires))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::development::{Issued, Issuer};

    fn files_in(folder: &Path) -> ServerFiles {
        let identity = IdentityFiles {
            certificate: folder.join("server.pem"),
            key: folder.join("server.key"),
        };
        ServerFiles { identity, client_authority: folder.join("ca.pem") }
    }

    fn issuer() -> Issuer {
        Issuer::new(SystemTime::now(), Duration::from_secs(3600)).unwrap()
    }

    fn write(files: &ServerFiles, own: &Issued) {
        std::fs::write(&files.identity.certificate, &own.certificate).unwrap();
        std::fs::write(&files.identity.key, &own.key).unwrap();
    }

    #[test]
    fn changed_files_are_taken_up_after_two_seconds_and_broken_ones_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let (files, issuer) = (files_in(folder.path()), issuer());
        let names = ["learner".to_owned()];
        write(&files, &issuer.server(&names).unwrap());
        std::fs::write(&files.client_authority, issuer.certificate()).unwrap();
        let tls = ServerTls::open(files.clone()).unwrap();
        let begin = Instant::now();
        let first = tls.config(begin);

        write(&files, &issuer.server(&names).unwrap());
        assert!(Arc::ptr_eq(&first, &tls.config(begin)), "it is too soon to look again");
        let second = tls.config(begin + LOOK_AGAIN * 2);
        assert!(!Arc::ptr_eq(&first, &second));

        std::fs::write(&files.identity.certificate, "half of a").unwrap();
        assert!(Arc::ptr_eq(&second, &tls.config(begin + LOOK_AGAIN * 3)));
        write(&files, &issuer.server(&names).unwrap());
        assert!(!Arc::ptr_eq(&second, &tls.config(begin + LOOK_AGAIN * 4)));
    }

    #[test]
    fn what_is_shown_for_debugging_holds_no_key() {
        let folder = tempfile::tempdir().unwrap();
        let (files, issuer) = (files_in(folder.path()), issuer());
        let own = issuer.server(&["learner".to_owned()]).unwrap();
        write(&files, &own);
        let contents =
            Contents { certificate: vec![], key: b"secret".to_vec(), client_authority: vec![] };
        assert_eq!(format!("{contents:?}"), "Contents { .. }");
    }
}
