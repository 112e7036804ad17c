//! The listening socket and the authentication it requires.

use std::sync::Arc;

use security::ServerTls;
use tokio::net::TcpListener;

/// A listening socket.
#[derive(Debug)]
pub struct Listener {
    pub(crate) listener: TcpListener,
    pub(crate) authentication: Authentication,
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
    pub fn authenticated(listener: TcpListener, tls: ServerTls) -> Self {
        Self { listener, authentication: Authentication::Tls(Arc::new(tls)) }
    }
}

/// A listener without authentication: every peer may make every call.
impl From<TcpListener> for Listener {
    fn from(listener: TcpListener) -> Self {
        Self { listener, authentication: Authentication::None }
    }
}
