//! Where a server listens, and whom it lets in.

use std::net::SocketAddr;

use anyhow::Context as _;
use learner::Door;
use security::ServerTls;
use tokio::net::TcpListener;

use crate::cli::ServerTlsArguments;
use crate::errors::Usage;

/// An address, and the certificates that are asked for there.
pub(super) struct Entrance {
    address: SocketAddr,
    tls: Option<ServerTls>,
}

impl Entrance {
    /// With the certificates read and checked.
    pub(super) fn new(address: SocketAddr, tls: &ServerTlsArguments) -> Result<Self, Usage> {
        let tls = tls.files().map(ServerTls::open).transpose();
        Ok(Self { address, tls: tls.map_err(|why| Usage::new(why.to_string()))? })
    }

    /// Listens; the door, and the URL by which it is reached.
    pub(super) async fn open(self) -> anyhow::Result<(Door, String)> {
        let address = self.address;
        let listener = TcpListener::bind(address)
            .await
            .with_context(|| format!("cannot listen on {address}"))?;
        let bound = listener.local_addr()?;
        Ok(match self.tls {
            Some(tls) => (Door::guarded(listener, tls), format!("https://{bound}")),
            None => (Door::from(listener), format!("http://{bound}")),
        })
    }
}

/// Nothing in plain text is encrypted, so other machines are let in only on request.
pub(super) fn demand_loopback(address: SocketAddr, tls: &ServerTlsArguments) -> Result<(), Usage> {
    if address.ip().is_loopback() || tls.files().is_some() {
        return Ok(());
    }
    Err(Usage::new(format!(
        "--listen {address} would let other machines in without encryption or identity; \
         give --tls-certificate, --tls-key and --tls-client-ca (`s2mia certs DIR` makes them), or \
         pass --insecure-allow-remote to allow that"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_is_let_in_without_being_told() {
        let plain = ServerTlsArguments::default();
        for address in ["127.0.0.1:50051", "[::1]:0"] {
            assert!(demand_loopback(address.parse().expect("an address"), &plain).is_ok());
        }
        for address in ["0.0.0.0:50051", "192.168.1.2:1", "[::]:0"] {
            assert!(demand_loopback(address.parse().expect("an address"), &plain).is_err());
        }
    }
}
