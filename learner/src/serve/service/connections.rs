//! Accepts connections: assigns ids, applies limits, performs the handshake, and reports closed connections, so that
//! the leases of an actor whose connection closed end immediately.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use proto::Refusal;
use security::{Permissions, Role, ServerTls};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;
use tonic::{Request, Status};

use super::handshake::{Accepted, ByteStream, accept_handshake};
use super::registry::{Admission, OF_ONE_ADDRESS, Registry};
use crate::lease::exchange::Caller;
use crate::lease::slots::ConnectionId;
use crate::serve::accepting::Accepting;
use crate::serve::listener::{Listener, RequiredToken};

/// Most concurrent result streams of one connection. Four threads of an actor share one, each works on at most two leases
/// at a time.
pub(super) const MOST_PUSHES: usize = 8;
/// Time between two warnings that connections are closed for new ones.
const WARNING_PAUSE: Duration = Duration::from_secs(10);

/// The peer of a connection.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    connection: ConnectionId,
    address: SocketAddr,
    permissions: Permissions,
    token: Option<Arc<RequiredToken>>,
    registry: Arc<Registry>,
    pushes: Arc<Semaphore>,
}

/// The peer of a request.
fn peer<T>(request: &Request<T>) -> &Peer {
    request.extensions().get().expect("tonic adds the peer of its connection to each request")
}

/// Marks the request's connection as one with an actor.
///
/// # Errors
/// Too many connections have actors, or the connection has closed.
pub(super) fn note_actor<T>(request: &Request<T>) -> Result<(), Refusal> {
    let peer = peer(request);
    peer.registry.note_actor(peer.connection)
}

/// Permits for the result streams of the request's connection.
pub(super) fn pushes<T>(request: &Request<T>) -> Arc<Semaphore> {
    Arc::clone(&peer(request).pushes)
}

/// The caller, for the log.
pub(super) fn caller<T>(request: &Request<T>, call: &'static str) -> Caller {
    let peer = peer(request);
    Caller { connection: peer.connection, peer: Some(peer.address), call }
}

/// An interceptor that rejects calls of peers without this role, or without the token that the learner requires.
pub(super) fn needs(role: Role) -> impl Fn(Request<()>) -> Result<Request<()>, Status> + Clone {
    move |request| {
        demand(&request, role)?;
        demand_token(&request)?;
        Ok(request)
    }
}

/// Rejects a call if its peer does not have this role.
pub(super) fn demand<T>(request: &Request<T>, role: Role) -> Result<(), Status> {
    let peer = peer(request);
    let denied = peer.permissions.demand(role);
    denied.map_err(|denied| peer.rejected(Status::permission_denied(denied.to_string())))
}

/// Rejects a call without the token, if the learner requires one.
pub(super) fn demand_token<T>(request: &Request<T>) -> Result<(), Status> {
    let peer = peer(request);
    let Some(token) = &peer.token else { return Ok(()) };
    token.demand(request.metadata()).map_err(|status| peer.rejected(status))
}

impl Peer {
    /// Logs why a call of this peer is rejected.
    fn rejected(&self, why: Status) -> Status {
        let message = why.message();
        tracing::warn!(peer = %self.address, "call rejected: {message}; the connection stays open");
        why
    }
}

/// Called with the id of each closed connection.
pub(super) type OnClose = Arc<dyn Fn(ConnectionId) + Send + Sync>;

/// Accepts connections until the returned stream is dropped.
/// At most `most_with_actors` of them may have actors.
pub(super) fn accept(
    listener: Listener,
    most_with_actors: usize,
    on_close: OnClose,
) -> ReceiverStream<io::Result<Connection>> {
    // At most one accepted connection waits for the server; further ones stay in the kernel's backlog.
    let (sender, stream) = mpsc::channel(1);
    tokio::spawn(async move {
        let registry = Registry::new(most_with_actors);
        let mut accepting = Accepting::new(listener.listener, "actors and clients");
        let mut last = 0;
        let mut quiet_until = Instant::now();
        loop {
            let (io, address) = tokio::select! {
                () = sender.closed() => return,
                accepted = accepting.next() => accepted,
            };
            if io.set_nodelay(true).is_err() {
                // The peer has closed it already.
                continue;
            }
            let id = ConnectionId(last + 1);
            let Some(Admission { closed, evicted }) = registry.admit(id, address.ip()) else {
                tracing::warn!(
                    peer = %address,
                    "connection closed: its address already has {OF_ONE_ADDRESS} connections"
                );
                continue;
            };
            last += 1;
            if evicted.is_some() && quiet_until <= Instant::now() {
                quiet_until = Instant::now() + WARNING_PAUSE;
                tracing::warn!(peer = %address, "too many connections without an actor; the oldest is closed to \
                     admit a new one");
            }
            let open = Open {
                id,
                on_close: Arc::clone(&on_close),
                closed,
                must_close: false,
                registry: Arc::clone(&registry),
            };
            // A separate task, so that a slow handshake does not delay other connections.
            let required = (listener.tls.clone(), listener.token.clone());
            tokio::spawn(admit(io, address, required, open, sender.clone()));
        }
    });
    ReceiverStream::new(stream)
}

/// Performs the handshake of one connection and passes the connection to the server.
async fn admit(
    io: TcpStream,
    address: SocketAddr,
    (tls, token): (Option<ServerTls>, Option<Arc<RequiredToken>>),
    mut open: Open,
    server: mpsc::Sender<io::Result<Connection>>,
) {
    let accepted = tokio::select! {
        () = server.closed() => return,
        _ = &mut open.closed => return,
        accepted = accept_handshake(io, address, tls.as_ref()) => accepted,
    };
    if let Some(Accepted { stream, permissions }) = accepted {
        // Sending fails if the server has ended; the connection is then dropped.
        let _sent = server
            .send(Ok(Connection {
                io: stream,
                peer: Peer {
                    connection: open.id,
                    address,
                    permissions,
                    token,
                    registry: Arc::clone(&open.registry),
                    pushes: Arc::new(Semaphore::new(MOST_PUSHES)),
                },
                open,
            }))
            .await;
    }
}

/// One accepted connection.
pub(super) struct Connection {
    io: Box<dyn ByteStream>,
    peer: Peer,
    open: Open,
}

/// The bookkeeping of an open connection; dropping it reports the connection as closed.
struct Open {
    id: ConnectionId,
    on_close: OnClose,
    /// Completes when the connection must close.
    closed: oneshot::Receiver<()>,
    must_close: bool,
    registry: Arc<Registry>,
}

impl Drop for Open {
    fn drop(&mut self) {
        // First, so that no actor registers after its leases have ended.
        self.registry.remove(self.id);
        (self.on_close)(self.id);
    }
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // A completed receiver must not be polled again.
        if self.open.must_close || Pin::new(&mut self.open.closed).poll(context).is_ready() {
            self.open.must_close = true;
            // End of stream: the server closes the connection.
            return Poll::Ready(Ok(()));
        }
        Pin::new(&mut self.io).poll_read(context, buffer)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write(context, buffer)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffers: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write_vectored(context, buffers)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }
}
