//! The listening socket and the authentication it requires.

use std::path::Path;
use std::sync::Arc;

use security::{ServerTls, Token};
use tokio::net::TcpListener;

use crate::run_folder::RunFolder;
use crate::token::RequiredToken;

/// A listening socket.
#[derive(Debug)]
pub struct Listener {
    pub(crate) listener: TcpListener,
    pub(crate) authentication: Authentication,
    /// Required of every call that changes the run.
    pub(crate) token: Option<Arc<RequiredToken>>,
}

/// What a new connection must present.
#[derive(Clone, Debug)]
pub(crate) enum Authentication {
    /// Nothing; all traffic is plain text.
    None,
    /// TLS and a client certificate that names a role.
    Tls(Arc<ServerTls>),
}

impl Listener {
    /// A listener that requires a client certificate. The certificate's role determines the permitted calls.
    #[must_use]
    pub fn authenticated(listener: TcpListener, tls: Arc<ServerTls>) -> Self {
        Self { listener, authentication: Authentication::Tls(tls), token: None }
    }

    /// The certificates of the listener, with TLS.
    pub(crate) fn tls(&self) -> Option<Arc<ServerTls>> {
        match &self.authentication {
            Authentication::None => None,
            Authentication::Tls(tls) => Some(Arc::clone(tls)),
        }
    }

    /// The same listener, which also requires `token`. The learner writes it to the run folder `folder`.
    #[must_use]
    pub fn with_token(self, token: Token, folder: &Path) -> Self {
        let file = RunFolder::token_file(folder);
        Self { token: Some(Arc::new(RequiredToken { token, file })), ..self }
    }
}

/// A listener without authentication: every peer may make every call.
impl From<TcpListener> for Listener {
    fn from(listener: TcpListener) -> Self {
        Self { listener, authentication: Authentication::None, token: None }
    }
}
