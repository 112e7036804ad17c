//! The first bytes of a connection: whether the peer speaks what this door asks for, and who it is. What is
//! refused here costs the run nothing, and both sides are told why.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use security::{ServerTls, Standing};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;

use super::opened::Opened;
use crate::door::Guard;

/// A connection that has not said who it is by then is closed.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long a refused peer has to read why.
const FAREWELL: Duration = Duration::from_secs(1);

/// The first byte of a TLS handshake (RFC 8446, section 5.1).
const TLS_HANDSHAKE: u8 = 22;
/// How a client of HTTP/2 begins (RFC 9113, section 3.4).
const PREFACE: [u8; 24] = *b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// How a server of HTTP/2 begins: settings, here none of them (RFC 9113, section 6.5). To a client that speaks
/// TLS they say that this is none.
const SETTINGS: [u8; 9] = [0, 0, 0, 4, 0, 0, 0, 0, 0];
/// How it ends (section 6.8): no stream was taken up, for the reason INADEQUATE_SECURITY, of which clients of
/// gRPC make the status PERMISSION_DENIED.
const GOODBYE: [u8; 17] = [0, 0, 8, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x0c];

/// A connection's bytes, encrypted or not.
pub(super) trait Bytes: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Bytes for T {}

/// A connection that may begin.
pub(super) struct Admitted {
    pub(super) bytes: Box<dyn Bytes>,
    pub(super) standing: Standing,
}

/// Lets a connection in, or says on both sides why not.
pub(super) async fn greet(stream: TcpStream, peer: SocketAddr, guard: &Guard) -> Option<Admitted> {
    match tokio::time::timeout(PATIENCE, admit(stream, guard)).await {
        Ok(Ok(admitted)) => return Some(admitted),
        Ok(Err(why)) => tracing::warn!(%peer, "a connection is refused: {why}; it is closed"),
        Err(_) => {
            let secs = PATIENCE.as_secs();
            tracing::warn!(%peer, "a connection did not say who it is within {secs} s; it is closed");
        }
    }
    None
}

async fn admit(stream: TcpStream, guard: &Guard) -> Result<Admitted, String> {
    let mut first = [0];
    // Nothing is taken from the stream; a peer that just left shows no byte at all.
    let said = stream.peek(&mut first).await.unwrap_or(0);
    match (guard, said, first[0]) {
        (_, 0, _) => Err("it closed at once".to_owned()),
        (Guard::Nobody, _, TLS_HANDSHAKE) => {
            part(stream, &SETTINGS).await;
            Err("it speaks TLS, but this learner serves plain text".to_owned())
        }
        (Guard::Nobody, ..) => {
            Ok(Admitted { bytes: opened(stream).await?, standing: Standing::Unasked })
        }
        (Guard::Tls(_), _, first) if first == PREFACE[0] => {
            part(stream, &[SETTINGS.as_slice(), &GOODBYE].concat()).await;
            Err("it speaks plain text, but this learner asks for TLS".to_owned())
        }
        (Guard::Tls(tls), ..) => shake_hands(stream, tls).await,
    }
}

async fn shake_hands(stream: TcpStream, tls: &Arc<ServerTls>) -> Result<Admitted, String> {
    let tls = Arc::clone(tls);
    let config = tokio::task::spawn_blocking(move || tls.config(Instant::now())).await;
    let config = config.map_err(|panic| panic.to_string())?;
    match TlsAcceptor::from(config).accept(stream).into_fallible().await {
        Ok(stream) => {
            let standing = Standing::of_chain(stream.get_ref().1.peer_certificates());
            Ok(Admitted { bytes: opened(stream).await?, standing })
        }
        Err((error, stream)) => {
            part(stream, &[]).await;
            Err(error.to_string())
        }
    }
}

/// Waits for the whole preface: the server behind has no patience of its own before it has one, and would keep
/// whoever stops in the middle for ever. What it is handed begins with the preface again.
async fn opened(mut stream: impl Bytes + 'static) -> Result<Box<dyn Bytes>, String> {
    let mut preface = [0; PREFACE.len()];
    let read = stream.read_exact(&mut preface).await;
    match read {
        Ok(_) if preface == PREFACE => Ok(Box::new(Opened { first: &PREFACE, stream })),
        Ok(_) => Err("it does not speak HTTP/2".to_owned()),
        Err(error) => Err(format!("it left before it had begun: {error}")),
    }
}

/// Says goodbye and waits until the peer has heard it. A socket closed with bytes unread would be reset, and
/// the peer would lose what it was told.
async fn part(mut stream: TcpStream, words: &[u8]) {
    let farewell = async {
        stream.write_all(words).await?;
        stream.shutdown().await?;
        let mut unheard = [0; 4096];
        while stream.read(&mut unheard).await? > 0 {}
        io::Result::Ok(())
    };
    // Whether the peer listens is its own affair.
    let _heard = tokio::time::timeout(FAREWELL, farewell).await;
}
