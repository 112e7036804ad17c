//! TLS of the learner: version 1.3, with a certificate required from every client. Changed files are reloaded without a
//! restart.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

use rustls::ServerConfig;
use rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use rustls::sign::SingleCertAndKey;

use crate::error::SecurityError;
use crate::files::{IdentityFiles, authorities, certified_key, provider, read, unusable};

/// Shortest interval between two checks of the files.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// ALPN name of the only supported protocol.
const HTTP_2: &[u8] = b"h2";

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
}

#[derive(Debug)]
struct State {
    config: Arc<ServerConfig>,
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
        let config = configure(&files, &contents)?;
        let state = State { config, seen: Ok(contents), looked: Instant::now() };
        Ok(Self { files, state: Mutex::new(state) })
    }

    /// The TLS settings of a connection that starts at `now`. Reads the files unless they were read within the last two
    /// seconds. Invalid files are logged once and change nothing.
    pub fn config(&self, now: Instant) -> Arc<ServerConfig> {
        let mut state = self.state.lock().expect("no thread panics while it holds this lock");
        if now.saturating_duration_since(state.looked) >= LOOK_AGAIN {
            state.looked = now;
            let found = Contents::read(&self.files);
            if found != state.seen {
                state.take_up(&self.files, found);
            }
        }
        Arc::clone(&state.config)
    }
}

impl State {
    fn take_up(&mut self, files: &ServerFiles, found: Result<Contents, SecurityError>) {
        let new = match &found {
            Ok(contents) => configure(files, contents),
            Err(error) => Err(error.clone()),
        };
        match new {
            Ok(config) => {
                self.config = config;
                tracing::info!("new connections are served with the changed certificates");
            }
            Err(error) => tracing::warn!("the previous certificates stay in use: {error}"),
        }
        self.seen = found;
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

fn configure(files: &ServerFiles, contents: &Contents) -> Result<Arc<ServerConfig>, SecurityError> {
    let now = SystemTime::now();
    let own = certified_key(&files.identity, &contents.certificate, &contents.key, now)?;
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
    Ok(Arc::new(config))
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
