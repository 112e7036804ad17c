//! Why a learner ended a connection as soon as it began. In TLS 1.3 a client has finished its handshake before
//! the server judges the client's certificate, and the HTTP/2 client may drop the reason that came before its
//! first request; here is nothing that could drop it.

use std::sync::Arc;
use std::time::Duration;

use security::ClientFiles;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tonic::transport::Uri;

/// A learner that is content opens with its settings well within this time.
const PATIENCE: Duration = Duration::from_secs(5);

/// How a client of HTTP/2 begins: with these bytes and its settings, here none (RFC 9113, section 3.4).
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
/// Frames of HTTP/2 (section 6): their header, the type of the one that says goodbye, and the reason in it that
/// asks for TLS.
const FRAME_HEADER: usize = 9;
const GOAWAY: u8 = 7;
const INADEQUATE_SECURITY: [u8; 4] = [0, 0, 0, 0x0c];

/// Shakes hands with the learner at `url` once more; `None` if it is content, or says nothing.
pub(super) async fn on_certificates(url: &str, files: &ClientFiles) -> Option<String> {
    tokio::time::timeout(PATIENCE, shake_hands(url, files)).await.ok().flatten()
}

/// Greets the learner at `url` in plain text once more; `None` if it is content, or says nothing.
pub(super) async fn on_plain_text(url: &str) -> Option<String> {
    let farewell = tokio::time::timeout(PATIENCE, second_frame(url)).await.ok().flatten()?;
    let asks = farewell.0 == GOAWAY && farewell.1.get(4..8) == Some(&INADEQUATE_SECURITY);
    asks.then(|| "the learner asks for TLS; use https://".to_owned())
}

/// Type and content of what follows the settings of the server at `url`.
async fn second_frame(url: &str) -> Option<(u8, Vec<u8>)> {
    let url: Uri = url.parse().ok()?;
    let mut stream = TcpStream::connect((host(&url)?, url.port_u16().unwrap_or(80))).await.ok()?;
    stream.write_all(PREFACE).await.ok()?;
    next_frame(&mut stream).await?;
    next_frame(&mut stream).await
}

async fn next_frame(stream: &mut TcpStream) -> Option<(u8, Vec<u8>)> {
    let mut header = [0; FRAME_HEADER];
    stream.read_exact(&mut header).await.ok()?;
    // The length has three bytes; frames of a beginning are short.
    let length = usize::from(u16::from_be_bytes([header[1], header[2]]));
    let mut content = vec![0; length];
    stream.read_exact(&mut content).await.ok()?;
    Some((header[3], content))
}

fn host(url: &Uri) -> Option<&str> {
    url.host().map(|host| host.trim_start_matches('[').trim_end_matches(']'))
}

async fn shake_hands(url: &str, files: &ClientFiles) -> Option<String> {
    let url: Uri = url.parse().ok()?;
    let host = host(&url)?;
    let port = url.port_u16().unwrap_or(443);
    let (config, name) = files.handshake(host).ok()?;
    let stream = TcpStream::connect((host, port)).await.ok()?;
    let mut stream = match TlsConnector::from(Arc::new(config)).connect(name, stream).await {
        Ok(stream) => stream,
        Err(error) => return security::explain(&error),
    };
    // A learner lets in who has begun to speak. If it has closed already, reading says why.
    let _heard = stream.write_all(PREFACE).await;
    let verdict = stream.read(&mut [0]).await.err()?;
    security::explain(&verdict)
}
