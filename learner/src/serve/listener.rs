//! The listening socket and the authentication it requires.

use std::path::Path;
use std::sync::Arc;

use security::{ServerTls, Token};
use tokio::net::TcpListener;

use crate::serve::token::RequiredToken;
use crate::store::run_folder::RunFolder;

/// A listening socket.
#[derive(Debug)]
pub struct Listener {
    pub(crate) listener: TcpListener,
    /// With it, every peer needs a certificate. Without, all traffic is plain text.
    pub(crate) tls: Option<ServerTls>,
    /// Required of every call that changes the run.
    pub(crate) token: Option<Arc<RequiredToken>>,
}

impl Listener {
    /// A listener that requires a client certificate. The certificate's role determines the permitted calls.
    #[must_use]
    pub fn authenticated(listener: TcpListener, tls: ServerTls) -> Self {
        Self { listener, tls: Some(tls), token: None }
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
        Self { listener, tls: None, token: None }
    }
}
