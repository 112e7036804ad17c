//! Handshake of a new connection: TLS with a client certificate, if the learner requires it, then the HTTP/2 preface. A
//! peer that stalls or is rejected does not affect the run.

use std::io::{self, Cursor};
use std::net::SocketAddr;
use std::time::Duration;

use security::{Permissions, ServerTls, explain_rejection};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;

/// Time limit of the handshake.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Time limit for sending a rejected peer the reason.
const REJECTION_TIMEOUT: Duration = Duration::from_secs(1);

/// The HTTP/2 client preface (RFC 9113, section 3.4).
const PREFACE: [u8; 24] = *b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// The first byte of a TLS handshake (RFC 8446, section 5.1).
const TLS_HANDSHAKE: u8 = 22;

/// The byte stream of a connection, encrypted or plain.
pub(super) trait ByteStream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> ByteStream for T {}

/// An accepted connection.
pub(super) struct Accepted {
    pub(super) stream: Box<dyn ByteStream>,
    pub(super) permissions: Permissions,
}

/// Performs the handshake, with TLS if `tls` is there. Rejects the connection with a log message.
pub(super) async fn accept_handshake(
    stream: TcpStream,
    peer: SocketAddr,
    tls: Option<&ServerTls>,
) -> Option<Accepted> {
    match tokio::time::timeout(TIMEOUT, handshake(stream, peer, tls)).await {
        Ok(Ok(accepted)) => return Some(accepted),
        Ok(Err(why)) => tracing::warn!(%peer, "connection rejected: {why}"),
        Err(_) => {
            let secs = TIMEOUT.as_secs();
            tracing::warn!(%peer, "connection closed: no handshake within {secs} s");
        }
    }
    None
}

async fn handshake(
    stream: TcpStream,
    peer: SocketAddr,
    tls: Option<&ServerTls>,
) -> Result<Accepted, String> {
    let Some(tls) = tls else {
        let stream = after_preface(stream, peer).await?;
        return Ok(Accepted { stream, permissions: Permissions::All });
    };
    match TlsAcceptor::from(tls.config()).accept(stream).into_fallible().await {
        Ok(stream) => {
            let permissions = Permissions::of_chain(stream.get_ref().1.peer_certificates());
            Ok(Accepted { stream: after_preface(stream, peer).await?, permissions })
        }
        Err((error, stream)) => {
            close(stream).await;
            Err(explain_rejection(&error))
        }
    }
}

/// Closes the connection after an alert, and reads until the peer closes it, too. Closing a socket with unread bytes
/// resets the connection, and the peer would lose the alert.
async fn close(mut stream: TcpStream) {
    let closing = async {
        stream.shutdown().await?;
        let mut unread = [0; 4096];
        while stream.read(&mut unread).await? > 0 {}
        io::Result::Ok(())
    };
    // The connection is dropped whether or not the peer received the alert.
    let _closed = tokio::time::timeout(REJECTION_TIMEOUT, closing).await;
}

/// Waits for the whole preface, since tonic's server waits for it without a timeout. The returned stream repeats it. It
/// also repeats what another protocol sends instead: the server then answers with its settings, which show a TLS client
/// that there is no TLS, and closes the connection.
async fn after_preface(
    mut stream: impl ByteStream + 'static,
    peer: SocketAddr,
) -> Result<Box<dyn ByteStream>, String> {
    let mut first = [0; PREFACE.len()];
    stream.read_exact(&mut first).await.map_err(|error| {
        format!("the peer closed it before the HTTP/2 preface was complete: {error}")
    })?;
    if first[0] == TLS_HANDSHAKE {
        tracing::warn!(%peer, "connection rejected: the peer speaks TLS, but this learner serves plain text");
    } else if first != PREFACE {
        tracing::warn!(%peer, "connection rejected: the peer does not speak HTTP/2");
    }
    let (rest, write) = tokio::io::split(stream);
    Ok(Box::new(tokio::io::join(Cursor::new(first).chain(rest), write)))
}
