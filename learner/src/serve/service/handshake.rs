//! Handshake of a new connection: checks that the peer speaks the required protocol and identifies it. Rejected peers
//! do not affect the run; both sides learn the reason.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use security::{ClientExpiry, ServerTls, Standing};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;

use super::replayed::Replayed;
use crate::listener::Authentication;

/// Time limit of the handshake.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Time limit for sending a rejected peer the reason.
const REJECTION_TIMEOUT: Duration = Duration::from_secs(1);

/// The first byte of a TLS handshake (RFC 8446, section 5.1).
const TLS_HANDSHAKE: u8 = 22;
/// The HTTP/2 client preface (RFC 9113, section 3.4).
const PREFACE: [u8; 24] = *b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// An empty SETTINGS frame, the first frame of an HTTP/2 server (RFC 9113, section 6.5). It shows a TLS client that the
/// server does not speak TLS.
const SETTINGS: [u8; 9] = [0, 0, 0, 4, 0, 0, 0, 0, 0];
/// A GOAWAY frame (section 6.8) with last stream 0 and error INADEQUATE_SECURITY, which gRPC clients map to
/// PERMISSION_DENIED.
const GOAWAY: [u8; 17] = [0, 0, 8, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x0c];

/// The byte stream of a connection, encrypted or plain.
pub(super) trait ByteStream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> ByteStream for T {}

/// An accepted connection.
pub(super) struct Accepted {
    pub(super) stream: Box<dyn ByteStream>,
    pub(super) standing: Standing,
    /// Of the client's certificate, with TLS.
    pub(super) expiry: Option<ClientExpiry>,
}

/// Performs the handshake. Rejects the connection with a log message and, where the protocol allows it, an answer.
pub(super) async fn accept_handshake(
    stream: TcpStream,
    peer: SocketAddr,
    authentication: &Authentication,
) -> Option<Accepted> {
    match tokio::time::timeout(TIMEOUT, handshake(stream, authentication)).await {
        Ok(Ok(accepted)) => return Some(accepted),
        Ok(Err(why)) => tracing::warn!(%peer, "connection rejected: {why}"),
        Err(_) => {
            let secs = TIMEOUT.as_secs();
            tracing::warn!(%peer, "connection closed: no handshake within {secs} s");
        }
    }
    None
}

async fn handshake(stream: TcpStream, authentication: &Authentication) -> Result<Accepted, String> {
    let mut first = [0];
    // `peek` leaves the byte in the stream; it returns 0 after the peer has closed the connection.
    let peeked = stream.peek(&mut first).await.unwrap_or(0);
    match (authentication, peeked, first[0]) {
        (_, 0, _) => Err("the peer closed it before sending anything".to_owned()),
        (Authentication::None, _, TLS_HANDSHAKE) => {
            reject(stream, &SETTINGS).await;
            Err("the peer speaks TLS, but this learner serves plain text".to_owned())
        }
        (Authentication::None, ..) => {
            let stream = after_preface(stream).await?;
            Ok(Accepted { stream, standing: Standing::Unasked, expiry: None })
        }
        (Authentication::Tls(_), _, first) if first == PREFACE[0] => {
            reject(stream, &[SETTINGS.as_slice(), &GOAWAY].concat()).await;
            Err("the peer speaks plain text, but this learner requires TLS".to_owned())
        }
        (Authentication::Tls(tls), ..) => tls_handshake(stream, tls).await,
    }
}

async fn tls_handshake(stream: TcpStream, tls: &Arc<ServerTls>) -> Result<Accepted, String> {
    let reading = Arc::clone(tls);
    let config = tokio::task::spawn_blocking(move || reading.config(Instant::now())).await;
    let config = config.map_err(|panic| panic.to_string())?;
    match TlsAcceptor::from(config).accept(stream).into_fallible().await {
        Ok(stream) => {
            let chain = stream.get_ref().1.peer_certificates();
            let (standing, expiry) = (Standing::of_chain(chain), tls.count_client(chain));
            Ok(Accepted { stream: after_preface(stream).await?, standing, expiry })
        }
        Err((error, stream)) => {
            reject(stream, &[]).await;
            Err(error.to_string())
        }
    }
}

/// Waits for the whole preface, since tonic's server waits for it without a timeout. The returned stream replays it.
async fn after_preface(
    mut stream: impl ByteStream + 'static,
) -> Result<Box<dyn ByteStream>, String> {
    let mut preface = [0; PREFACE.len()];
    let read = stream.read_exact(&mut preface).await;
    match read {
        Ok(_) if preface == PREFACE => Ok(Box::new(Replayed { first: &PREFACE, stream })),
        Ok(_) => Err("the peer does not speak HTTP/2".to_owned()),
        Err(error) => {
            Err(format!("the peer closed it before the HTTP/2 preface was complete: {error}"))
        }
    }
}

/// Sends `frames`, then reads until the peer closes. Closing a socket with unread bytes resets the connection, and the
/// peer would lose the frames.
async fn reject(mut stream: TcpStream, frames: &[u8]) {
    let rejection = async {
        stream.write_all(frames).await?;
        stream.shutdown().await?;
        let mut unread = [0; 4096];
        while stream.read(&mut unread).await? > 0 {}
        io::Result::Ok(())
    };
    // The connection is closed whether or not the peer received the frames.
    let _result = tokio::time::timeout(REJECTION_TIMEOUT, rejection).await;
}
