//! Why a learner ended a TLS connection. In TLS 1.3 a client has finished its handshake before the server
//! judges the client's certificate, and HTTP/2 then drops the reason; here is nothing that could drop it.

use std::sync::Arc;
use std::time::Duration;

use security::ClientFiles;
use tokio::io::AsyncReadExt as _;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tonic::transport::Uri;

/// A learner that is content opens with its settings well within this time.
const PATIENCE: Duration = Duration::from_secs(5);

/// Shakes hands with the learner at `url` once more; `None` if it is content, or says nothing.
pub(super) async fn ask(url: &str, files: &ClientFiles) -> Option<String> {
    tokio::time::timeout(PATIENCE, shake_hands(url, files)).await.ok().flatten()
}

async fn shake_hands(url: &str, files: &ClientFiles) -> Option<String> {
    let url: Uri = url.parse().ok()?;
    let host = url.host()?.trim_start_matches('[').trim_end_matches(']');
    let port = url.port_u16().unwrap_or(443);
    let (config, name) = files.handshake(host).ok()?;
    let stream = TcpStream::connect((host, port)).await.ok()?;
    let mut stream = match TlsConnector::from(Arc::new(config)).connect(name, stream).await {
        Ok(stream) => stream,
        Err(error) => return security::explain(&error),
    };
    let verdict = stream.read(&mut [0]).await.err()?;
    security::explain(&verdict)
}
