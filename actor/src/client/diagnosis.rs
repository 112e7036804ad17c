//! Finds the reason why a learner closed a new connection. In TLS 1.3 a client finishes its handshake before the server
//! checks the client's certificate, and the HTTP/2 client may drop a reason that arrives before its first request. A
//! second connection without an HTTP/2 client receives it.

use std::sync::Arc;
use std::time::Duration;

use security::ClientFiles;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tonic::transport::Uri;

/// Deadline for the learner's first frames.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Connection preface of an HTTP/2 client, with empty settings (RFC 9113, section 3.4).
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
/// HTTP/2 frames (section 6): size of the header, type GOAWAY, and the error code INADEQUATE_SECURITY.
const FRAME_HEADER: usize = 9;
const GOAWAY: u8 = 7;
const INADEQUATE_SECURITY: [u8; 4] = [0, 0, 0, 0x0c];

/// Repeats the TLS handshake with the learner at `url`; returns the reason of its rejection, if any.
pub(super) async fn on_certificates(url: &str, files: &ClientFiles) -> Option<String> {
    tokio::time::timeout(TIMEOUT, tls_handshake(url, files)).await.ok().flatten()
}

/// Connects to the learner at `url` in plain text; returns a reason if it requires TLS.
pub(super) async fn on_plain_text(url: &str) -> Option<String> {
    let frame = tokio::time::timeout(TIMEOUT, second_frame(url)).await.ok().flatten()?;
    let needs_tls = frame.0 == GOAWAY && frame.1.get(4..8) == Some(&INADEQUATE_SECURITY);
    needs_tls.then(|| "the learner requires TLS; use https://".to_owned())
}

/// Type and content of the second frame of the server at `url`; the first has its settings.
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
    // The length has three bytes; the first frames are short, so the highest byte is 0.
    let length = usize::from(u16::from_be_bytes([header[1], header[2]]));
    let mut content = vec![0; length];
    stream.read_exact(&mut content).await.ok()?;
    Some((header[3], content))
}

fn host(url: &Uri) -> Option<&str> {
    url.host().map(|host| host.trim_start_matches('[').trim_end_matches(']'))
}

async fn tls_handshake(url: &str, files: &ClientFiles) -> Option<String> {
    let url: Uri = url.parse().ok()?;
    let host = host(&url)?;
    let port = url.port_u16().unwrap_or(443);
    let (config, name) = files.handshake(host).ok()?;
    let stream = TcpStream::connect((host, port)).await.ok()?;
    let mut stream = match TlsConnector::from(Arc::new(config)).connect(name, stream).await {
        Ok(stream) => stream,
        Err(error) => return security::explain(&error),
    };
    // The learner accepts a connection after its first bytes. If it has closed it, reading returns the reason.
    let _sent = stream.write_all(PREFACE).await;
    let error = stream.read(&mut [0]).await.err()?;
    security::explain(&error)
}
