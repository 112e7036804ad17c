//! Where connections come in, and what is asked of whoever stands there.

use std::sync::Arc;

use security::ServerTls;
use tokio::net::TcpListener;

/// A socket that is listened on.
#[derive(Debug)]
pub struct Door {
    pub(crate) listener: TcpListener,
    pub(crate) guard: Guard,
}

/// What is asked of a new connection.
#[derive(Clone, Debug)]
pub(crate) enum Guard {
    /// Nothing: everything is plain text.
    Nobody,
    /// TLS, and a certificate with a role in it.
    Tls(Arc<ServerTls>),
}

impl Door {
    /// A door through which only those come who show a certificate; what they may do stands in it.
    #[must_use]
    pub fn guarded(listener: TcpListener, tls: ServerTls) -> Self {
        Self { listener, guard: Guard::Tls(Arc::new(tls)) }
    }
}

/// An open door: whoever reaches the socket may do everything.
impl From<TcpListener> for Door {
    fn from(listener: TcpListener) -> Self {
        Self { listener, guard: Guard::Nobody }
    }
}
