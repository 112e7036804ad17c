//! Accepted connections: numbered, counted, greeted, and reported when they close, so that the leases of an actor
//! that died are free at once.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use proto::Refusal;
use security::{Role, Standing};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;
use tonic::{Request, Status};

use super::crowd::{self, Crowd};
use super::greeting::{Admitted, Bytes, greet};
use super::registry::{self, Admission, Registry};
use crate::door::{Door, Guard};
use crate::exchange::Caller;
use crate::slots::ConnectionId;

/// Streams of results that one connection may have open at a time. An actor works off two leases at a time.
const MOST_PUSHES: usize = 2;
/// Connections of one address, so that no machine by itself can keep all others out.
const MOST_OF_ONE_ADDRESS: usize = 512;
/// Time between two warnings that connections are closed for new ones.
const WARNING_PAUSE: Duration = Duration::from_secs(10);
/// Pause after a failed accept, for example because the process is out of file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Who is at the other end of a connection.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    connection: ConnectionId,
    address: SocketAddr,
    standing: Standing,
    registry: Arc<Registry>,
    pushes: Arc<Semaphore>,
}

/// An actor registers on the connection of this request.
///
/// # Errors
/// Refuses it when too many connections have actors.
pub(super) fn note_actor<T>(request: &Request<T>) -> Result<(), Refusal> {
    let peer: Option<&Peer> = request.extensions().get();
    peer.map_or(Ok(()), |peer| peer.registry.note_actor(peer.connection))
}

/// The streams of results that the connection of this request may open.
pub(super) fn pushes<T>(request: &Request<T>) -> Arc<Semaphore> {
    let peer: Option<&Peer> = request.extensions().get();
    peer.map_or_else(|| Arc::new(Semaphore::new(1)), |peer| Arc::clone(&peer.pushes))
}

/// The connection that a request came over.
pub(super) fn of<T>(request: &Request<T>) -> ConnectionId {
    request.extensions().get().map_or(ConnectionId(0), |peer: &Peer| peer.connection)
}

/// Who makes a call, for the log.
pub(super) fn caller<T>(request: &Request<T>, call: &'static str) -> Caller {
    let peer: Option<&Peer> = request.extensions().get();
    Caller { connection: of(request), peer: peer.map(|peer| peer.address), call }
}

/// Lets calls pass whose peer has this role, and refuses all others by name.
pub(super) fn needs(role: Role) -> impl Fn(Request<()>) -> Result<Request<()>, Status> + Clone {
    move |request| demand(&request, role).map(|()| request)
}

/// Refuses a call whose peer has not this role.
pub(super) fn demand<T>(request: &Request<T>, role: Role) -> Result<(), Status> {
    let peer: Option<&Peer> = request.extensions().get();
    // Without a peer the call came over no socket.
    let Some(peer) = peer else { return Ok(()) };
    peer.standing.demand(role).map_err(|denied| {
        tracing::warn!(peer = %peer.address, "a call is refused: {denied}; the connection stays open");
        Status::permission_denied(denied.to_string())
    })
}

/// Told of each connection that has closed.
pub(super) type Farewell = Arc<dyn Fn(ConnectionId) + Send + Sync>;

/// Accepts connections until the returned stream is dropped.
/// At most `most_with_actors` of them may have actors.
pub(super) fn accept(
    door: Door,
    most_with_actors: usize,
    farewell: Farewell,
) -> ReceiverStream<io::Result<Connection>> {
    // One accepted connection waits for the server; the others stay with the kernel.
    let (sender, stream) = mpsc::channel(1);
    tokio::spawn(async move {
        let registry = Registry::new(most_with_actors);
        let crowd = Crowd::new(MOST_OF_ONE_ADDRESS);
        let (mut last, mut quiet_until) = (0, Instant::now());
        loop {
            let accepted = tokio::select! {
                () = sender.closed() => return,
                accepted = door.listener.accept() => accepted,
            };
            match accepted.and_then(|(io, address)| io.set_nodelay(true).map(|()| (io, address))) {
                Ok((io, address)) => {
                    let Some(place) = crowd.admit(address.ip()) else {
                        let most = MOST_OF_ONE_ADDRESS;
                        tracing::warn!(peer = %address, "a connection is refused: its address has {most} \
                             already; it is closed");
                        continue;
                    };
                    last += 1;
                    let id = ConnectionId(last);
                    let farewell = Arc::clone(&farewell);
                    let Admission { place: registered, closed, evicted } = registry.admit(id);
                    if evicted.is_some() && quiet_until <= Instant::now() {
                        quiet_until = Instant::now() + WARNING_PAUSE;
                        tracing::warn!(peer = %address, "too many connections without an actor are open; the \
                             oldest is closed for a new one");
                    }
                    let places = (place, registered);
                    let open = Open {
                        id,
                        farewell,
                        closed,
                        registry: Arc::clone(&registry),
                        _places: places,
                    };
                    // Whoever is slow to say who they are keeps nobody else waiting.
                    tokio::spawn(usher(io, address, door.guard.clone(), open, sender.clone()));
                }
                Err(error) => {
                    tracing::warn!(
                        "cannot accept a connection: {error}; it is tried again in a moment"
                    );
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            }
        }
    });
    ReceiverStream::new(stream)
}

/// Greets one connection and hands it over to the server.
async fn usher(
    io: TcpStream,
    address: SocketAddr,
    guard: Guard,
    mut open: Open,
    server: mpsc::Sender<io::Result<Connection>>,
) {
    let greeted = tokio::select! {
        () = server.closed() => return,
        _ = &mut open.closed => return,
        greeted = greet(io, address, &guard) => greeted,
    };
    if let Some(Admitted { bytes, standing }) = greeted {
        // A server that is gone takes nobody in any more.
        let _taken = server
            .send(Ok(Connection {
                io: bytes,
                peer: Peer {
                    connection: open.id,
                    address,
                    standing,
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
    io: Box<dyn Bytes>,
    peer: Peer,
    open: Open,
}

/// Says when it is closed.
struct Open {
    id: ConnectionId,
    farewell: Farewell,
    /// Ends when the connection has to close.
    closed: oneshot::Receiver<()>,
    registry: Arc<Registry>,
    _places: (crowd::Place, registry::Place),
}

impl Drop for Open {
    fn drop(&mut self) {
        (self.farewell)(self.id);
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
        if Pin::new(&mut self.open.closed).poll(context).is_ready() {
            // No more bytes: the server ends the connection.
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
