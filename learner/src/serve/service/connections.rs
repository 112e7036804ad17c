//! Accepts connections: assigns ids, applies limits, performs the handshake, and reports closed connections, so that
//! the leases of a dead actor are free at once.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use proto::Refusal;
use security::{ClientExpiry, Role, Standing};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;
use tonic::{Request, Status};

use super::handshake::{Accepted, ByteStream, accept_handshake};
use super::per_address::{self, PerAddressLimit};
use super::registry::{Admission, Registry};
use crate::accepting::Accepting;
use crate::exchange::Caller;
use crate::listener::{Authentication, Listener};
use crate::slots::ConnectionId;
use crate::token::RequiredToken;

/// Most concurrent result streams of one connection. Four threads of an actor share one, each works on at most two leases
/// at a time.
pub(super) const MOST_PUSHES: usize = 8;
/// Most connections of one address, so that one machine cannot use up all connections.
const MOST_OF_ONE_ADDRESS: usize = 512;
/// Time between two warnings that connections are closed for new ones.
const WARNING_PAUSE: Duration = Duration::from_secs(10);

/// The peer of a connection.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    connection: ConnectionId,
    address: SocketAddr,
    standing: Standing,
    token: Option<Arc<RequiredToken>>,
    registry: Arc<Registry>,
    pushes: Arc<Semaphore>,
}

/// Marks the request's connection as one with an actor.
///
/// # Errors
/// Too many connections have actors, or the connection has closed.
pub(super) fn note_actor<T>(request: &Request<T>) -> Result<(), Refusal> {
    let peer: Option<&Peer> = request.extensions().get();
    peer.map_or(Ok(()), |peer| peer.registry.note_actor(peer.connection))
}

/// Permits for the result streams of the request's connection.
pub(super) fn pushes<T>(request: &Request<T>) -> Arc<Semaphore> {
    let peer: Option<&Peer> = request.extensions().get();
    peer.map_or_else(|| Arc::new(Semaphore::new(1)), |peer| Arc::clone(&peer.pushes))
}

/// The connection of a request.
pub(super) fn of<T>(request: &Request<T>) -> ConnectionId {
    request.extensions().get().map_or(ConnectionId(0), |peer: &Peer| peer.connection)
}

/// The caller, for the log.
pub(super) fn caller<T>(request: &Request<T>, call: &'static str) -> Caller {
    let peer: Option<&Peer> = request.extensions().get();
    Caller { connection: of(request), peer: peer.map(|peer| peer.address), call }
}

/// An interceptor that rejects calls of peers without this role.
pub(super) fn needs(role: Role) -> impl Fn(Request<()>) -> Result<Request<()>, Status> + Clone {
    move |request| demand(&request, role).map(|()| request)
}

/// Rejects a call if its peer does not have this role, or if it lacks the token that the role needs.
pub(super) fn demand<T>(request: &Request<T>, role: Role) -> Result<(), Status> {
    let peer: Option<&Peer> = request.extensions().get();
    // A call without a peer did not come over a socket.
    let Some(peer) = peer else { return Ok(()) };
    let allowed = peer.standing.demand(role);
    let allowed = allowed.map_err(|denied| Status::permission_denied(denied.to_string()));
    let token = peer.token.as_ref();
    let allowed =
        allowed.and_then(|()| token.map_or(Ok(()), |token| token.demand(request.metadata(), role)));
    allowed.inspect_err(|denied| {
        let why = denied.message();
        tracing::warn!(peer = %peer.address, "call rejected: {why}; the connection stays open");
    })
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
        let limit = PerAddressLimit::new(MOST_OF_ONE_ADDRESS);
        let mut accepting = Accepting::new(listener.listener, "actors and clients");
        let (mut last, mut quiet_until) = (0, Instant::now());
        loop {
            let (io, address) = tokio::select! {
                () = sender.closed() => return,
                accepted = accepting.next() => accepted,
            };
            if io.set_nodelay(true).is_err() {
                // The peer has closed it already.
                continue;
            }
            let Some(permit) = limit.acquire(address.ip()) else {
                let most = MOST_OF_ONE_ADDRESS;
                tracing::warn!(peer = %address, "connection closed: its address already has {most} connections");
                continue;
            };
            last += 1;
            let id = ConnectionId(last);
            let on_close = Arc::clone(&on_close);
            let Admission { closed, evicted } = registry.admit(id);
            if evicted.is_some() && quiet_until <= Instant::now() {
                quiet_until = Instant::now() + WARNING_PAUSE;
                tracing::warn!(peer = %address, "too many connections without an actor; the oldest is closed to \
                     admit a new one");
            }
            let open = Open {
                id,
                on_close,
                closed,
                must_close: false,
                registry: Arc::clone(&registry),
                _permit: permit,
            };
            // A separate task, so that a slow handshake does not delay other connections.
            let required = (listener.authentication.clone(), listener.token.clone());
            tokio::spawn(admit(io, address, required, open, sender.clone()));
        }
    });
    ReceiverStream::new(stream)
}

/// Performs the handshake of one connection and passes the connection to the server.
async fn admit(
    io: TcpStream,
    address: SocketAddr,
    (authentication, token): (Authentication, Option<Arc<RequiredToken>>),
    mut open: Open,
    server: mpsc::Sender<io::Result<Connection>>,
) {
    let accepted = tokio::select! {
        () = server.closed() => return,
        _ = &mut open.closed => return,
        accepted = accept_handshake(io, address, &authentication) => accepted,
    };
    if let Some(Accepted { stream, standing, expiry }) = accepted {
        // Sending fails if the server has ended; the connection is then dropped.
        let _sent = server
            .send(Ok(Connection {
                io: stream,
                peer: Peer {
                    connection: open.id,
                    address,
                    standing,
                    token,
                    registry: Arc::clone(&open.registry),
                    pushes: Arc::new(Semaphore::new(MOST_PUSHES)),
                },
                open,
                _expiry: expiry,
            }))
            .await;
    }
}

/// One accepted connection.
pub(super) struct Connection {
    io: Box<dyn ByteStream>,
    peer: Peer,
    open: Open,
    _expiry: Option<ClientExpiry>,
}

/// The bookkeeping of an open connection; dropping it reports the connection as closed.
struct Open {
    id: ConnectionId,
    on_close: OnClose,
    /// Completes when the connection must close.
    closed: oneshot::Receiver<()>,
    must_close: bool,
    registry: Arc<Registry>,
    _permit: per_address::Permit,
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
