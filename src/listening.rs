//! Addresses on which this program accepts connections, and the tokens that it requires there.

pub(crate) mod token;

use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::Context as _;
use learner::Listener;
use security::ServerTls;
use tokio::net::TcpListener;

use crate::cli::ServerTlsArguments;
use crate::errors::Usage;

/// Parses the address of an option, for clap.
pub(crate) fn address(text: &str) -> Result<SocketAddr, String> {
    let form = "expected an IP address with a port, such as 127.0.0.1:50051 or [::1]:50051";
    text.parse().map_err(|_| match security::addresses::check_port(text) {
        Err(port) => port.to_string(),
        Ok(()) => form.to_owned(),
    })
}

/// Refuses `address`, given by `flag`, if other machines can reach it; `permission` says how to allow that.
pub(crate) fn demand_loopback(
    flag: &str,
    address: SocketAddr,
    permission: &str,
) -> Result<(), Usage> {
    if address.ip().is_loopback() {
        return Ok(());
    }
    Err(Usage::new(format!(
        "{flag} {address} would accept other machines without encryption and authentication; {permission}"
    )))
}

/// The address of `--listen` and the certificates that it requires.
pub(crate) struct Listening {
    address: SocketAddr,
    tls: Option<Arc<ServerTls>>,
}

impl Listening {
    /// Reads and checks the certificates. Without any, refuses an address that other machines can reach unless
    /// `--insecure-allow-remote` is given.
    pub(crate) fn new(address: SocketAddr, arguments: &ServerTlsArguments) -> Result<Self, Usage> {
        let tls = arguments.files().map(ServerTls::open).transpose();
        let tls = tls.map_err(|why| Usage::new(why.to_string()))?;
        if tls.is_none() && !arguments.insecure_allow_remote {
            let permission = "give --tls-certificate, --tls-key and --tls-client-ca \
                 (`s2mia certs DIR` makes them), or pass --insecure-allow-remote to allow that";
            demand_loopback("--listen", address, permission)?;
        }
        Ok(Self { address, tls: tls.map(Arc::new) })
    }

    /// The certificates, if there are any.
    pub(crate) fn tls(&self) -> Option<Arc<ServerTls>> {
        self.tls.clone()
    }

    /// Binds the address; returns the listener and its URL.
    pub(crate) async fn open(self) -> anyhow::Result<(Listener, String)> {
        let address = self.address;
        let listener = TcpListener::bind(address)
            .await
            .with_context(|| format!("cannot listen on {address}; --listen selects another"))?;
        let bound = listener.local_addr()?;
        Ok(match self.tls {
            Some(tls) => (Listener::authenticated(listener, tls), format!("https://{bound}")),
            None => (Listener::from(listener), format!("http://{bound}")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_cannot_be_used_is_refused_with_its_port_or_the_form() {
        assert_eq!(address("[::1]:0"), Ok("[::1]:0".parse().unwrap()));
        assert_eq!(
            address("127.0.0.1:99999").unwrap_err(),
            "the port 99999 is not a number from 0 to 65535"
        );
        for text in ["localhost:50051", "127.0.0.1", "50051"] {
            assert!(address(text).unwrap_err().starts_with("expected an IP address"), "{text}");
        }
    }

    #[test]
    fn plain_text_is_accepted_from_loopback_only() {
        for address in ["127.0.0.1:50051", "[::1]:0"] {
            assert!(demand_loopback("--listen", address.parse().unwrap(), "").is_ok());
        }
        for address in ["0.0.0.0:50051", "192.168.1.2:1", "[::]:0"] {
            assert!(demand_loopback("--listen", address.parse().unwrap(), "").is_err());
        }
    }
}
