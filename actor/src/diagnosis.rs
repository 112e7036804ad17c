//! Finds the reason why a learner closed a new connection. In TLS 1.3 a client finishes its handshake before the server
//! checks the client's certificate, and the HTTP/2 client may drop a reason that arrives before its first request. A
//! second connection without an HTTP/2 client receives it.

use std::time::Duration;

use security::ClientTls;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tonic::transport::Uri;

/// Connection preface of an HTTP/2 client, with empty settings (RFC 9113, section 3.4).
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
/// The first byte of a TLS alert (RFC 8446, section 5.1), which answers a client without TLS.
const TLS_ALERT: u8 = 21;

/// What is wrong with plain text to a learner with certificates.
const REQUIRES_TLS: &str =
    "the learner requires TLS; use https:// with --tls-ca, --tls-certificate and --tls-key";

/// Repeats the connection to the learner at `url`, over TLS with `tls`, within `timeout`; returns the reason if the TLS
/// settings of the two sides do not match.
pub async fn reason(url: &str, tls: Option<&ClientTls>, timeout: Duration) -> Option<String> {
    match tls {
        Some(tls) => tokio::time::timeout(timeout, tls_handshake(url, tls)).await.ok().flatten(),
        None => {
            let first = tokio::time::timeout(timeout, first_byte(url)).await.ok().flatten()?;
            (first == TLS_ALERT).then(|| REQUIRES_TLS.to_owned())
        }
    }
}

/// The first byte that the server at `url` answers.
async fn first_byte(url: &str) -> Option<u8> {
    let url: Uri = url.parse().ok()?;
    let mut stream = TcpStream::connect((host(&url)?, url.port_u16().unwrap_or(80))).await.ok()?;
    stream.write_all(PREFACE).await.ok()?;
    stream.read_u8().await.ok()
}

fn host(url: &Uri) -> Option<&str> {
    url.host().map(|host| host.trim_start_matches('[').trim_end_matches(']'))
}

async fn tls_handshake(url: &str, tls: &ClientTls) -> Option<String> {
    let url: Uri = url.parse().ok()?;
    let host = host(&url)?;
    let port = url.port_u16().unwrap_or(443);
    let (config, name) = tls.handshake(host)?;
    let stream = TcpStream::connect((host, port)).await.ok()?;
    let mut stream = match TlsConnector::from(config).connect(name, stream).await {
        Ok(stream) => stream,
        Err(error) => return security::explain(&error),
    };
    // The learner accepts a connection after its first bytes. If it has closed it, reading returns the reason.
    let _sent = stream.write_all(PREFACE).await;
    let error = stream.read(&mut [0]).await.err()?;
    security::explain(&error)
}
