//! Endpoints of servers and clients: addresses and who can reach them, TLS arguments, the run's page, and tokens.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context as _;
use clap::Args;
use learner::serve::listener::Listener;
use learner::serve::page::{Hosts, Page};
use learner::store::run_folder::RunFolder;
use security::{ClientTls, IdentityFiles, ServerTls, Token};
use tokio::net::TcpListener;

use crate::errors::Usage;
use crate::process::output;

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
    // As for clients, loopback includes 127.0.0.0/8 in the form of IPv6.
    if address.ip().to_canonical().is_loopback() {
        return Ok(());
    }
    Err(Usage::new(format!(
        "{flag} {address} would accept other machines without encryption and authentication; {permission}"
    )))
}

/// The address of `--listen` and the certificates that it requires.
pub(crate) struct Listening {
    address: SocketAddr,
    pub(crate) tls: Option<ServerTls>,
}

impl Listening {
    /// Reads and checks the certificates. Without any, refuses an address that other machines can reach unless
    /// `--insecure-allow-remote` is given.
    pub(crate) fn new(address: SocketAddr, arguments: &ServerTlsArguments) -> Result<Self, Usage> {
        let tls = arguments.read()?;
        if tls.is_none() && !arguments.insecure_allow_remote {
            let permission = "give --tls-certificate, --tls-key and --tls-client-ca \
                 (`s2mia certs DIR` makes them), or pass --insecure-allow-remote to allow that";
            demand_loopback("--listen", address, permission)?;
        }
        Ok(Self { address, tls })
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

/// The web page of `s2mia train` and `s2mia learner`.
#[derive(Args, Clone, Debug)]
pub(crate) struct PageArguments {
    /// Address of the run's web page and Prometheus metrics (/metrics); off disables both.
    #[arg(long, value_name = "ADDRESS | off", default_value = "127.0.0.1:0")]
    page: PageAddress,
    /// Access.
    #[command(flatten)]
    access: PageAccess,
}

/// Who may see a page.
#[derive(Args, Clone, Debug)]
pub(crate) struct PageAccess {
    /// Additional host names and addresses accepted in requests for the page, besides loopback.
    #[arg(long, value_name = "HOST,...", value_delimiter = ',')]
    page_host: Vec<String>,
    /// Allow a page on a non-loopback address without encryption and authentication.
    #[arg(long)]
    insecure_allow_remote_page: bool,
}

/// Address of the page, if it is enabled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PageAddress {
    /// The page is disabled.
    Off,
    /// Address to listen on; port 0 selects a free port.
    At(SocketAddr),
}

impl FromStr for PageAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "off" {
            return Ok(Self::Off);
        }
        let address = address(text).map(Self::At);
        address.map_err(|why| {
            format!("{why}; allowed are off and an address with a port, such as 127.0.0.1:8080")
        })
    }
}

impl PageArguments {
    /// Refuses an address that other machines can reach in plain text unless that is allowed.
    pub(crate) fn check(&self, tls: Option<&ServerTls>) -> Result<(), Usage> {
        let PageAddress::At(address) = self.page else { return Ok(()) };
        let permission = "pass --page-tls (s2mia learner with certificates) or --insecure-allow-remote-page to allow \
             that, and --page-host with the names they use";
        match tls {
            Some(_) => self.access.hosts(None).map(drop),
            None => self.access.check("--page", address, permission),
        }
    }

    /// Opens the page, if it is enabled, and prints its URL.
    ///
    /// # Errors
    /// The address is in use or invalid.
    pub(crate) async fn open(&self, tls: Option<ServerTls>) -> anyhow::Result<Option<Page>> {
        let PageAddress::At(address) = self.page else { return Ok(None) };
        let advice = "choose another port, or 0 for any free one, or --page off";
        Ok(Some(self.access.open(("--page", address), advice, tls).await?))
    }
}

impl PageAccess {
    /// Refuses invalid host names, and the address that `flag` gives if other machines can reach it and are not allowed to.
    pub(crate) fn check(
        &self,
        flag: &str,
        address: SocketAddr,
        permission: &str,
    ) -> Result<(), Usage> {
        self.hosts(None)?;
        if self.insecure_allow_remote_page {
            return Ok(());
        }
        demand_loopback(flag, address, permission)
    }

    /// Opens a page at the address that `flag` gives and prints its URL; `advice` says what else to do if that fails.
    pub(crate) async fn open(
        &self,
        (flag, address): (&str, SocketAddr),
        advice: &str,
        tls: Option<ServerTls>,
    ) -> anyhow::Result<Page> {
        let listener = TcpListener::bind(address).await.map_err(|error| {
            let line = format!("{flag} {address}: {error}; {advice}");
            match error.kind() {
                // It may be free later.
                ErrorKind::AddrInUse => anyhow::Error::msg(line),
                _ => Usage::new(line).into(),
            }
        })?;
        let scheme = if tls.is_some() { "https" } else { "http" };
        let bound = listener.local_addr()?;
        output::line(format!("page: {scheme}://{}", reachable(bound)));
        Ok(Page { listener, hosts: self.hosts(Some(bound.ip()))?, tls })
    }

    /// The hosts that `--page-host` allows, and the address on which the page listens: no website can use an address as its name.
    fn hosts(&self, bound: Option<IpAddr>) -> Result<Hosts, Usage> {
        let own = bound.filter(|ip| !ip.is_unspecified()).map(|ip| ip.to_string());
        let hosts: Vec<_> = self.page_host.iter().cloned().chain(own).collect();
        Hosts::with(&hosts).map_err(|error| Usage::new(format!("--page-host: {error}")))
    }
}

/// Where this machine reaches a server that listens on `address`: on loopback, if it listens on all addresses.
pub(crate) fn reachable(address: SocketAddr) -> SocketAddr {
    let loopback = match address.ip() {
        IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
    };
    if address.ip().is_unspecified() { SocketAddr::new(loopback, address.port()) } else { address }
}

/// The token in `S2MIA_TOKEN`, if the variable is set.
///
/// # Errors
/// The variable contains no token.
pub(crate) fn token_of_environment() -> Result<Option<Token>, Usage> {
    let Some(text) = std::env::var_os(Token::VARIABLE) else { return Ok(None) };
    let token = Token::parse(&text.to_string_lossy());
    token.map(Some).map_err(|why| Usage::new(format!("cannot use {}: {why}", Token::VARIABLE)))
}

/// The token of the run in `folder`, else that in `S2MIA_TOKEN`, if either exists.
///
/// # Errors
/// A token cannot be read.
pub(crate) fn token_for_run(folder: &Path) -> anyhow::Result<Option<Token>> {
    match RunFolder::token(folder)? {
        Some(token) => Ok(Some(token)),
        None => Ok(token_of_environment()?),
    }
}

/// TLS files of a server, or permission to do without.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ServerTlsArguments {
    /// Allow a non-loopback --listen address without encryption and authentication.
    #[arg(long, conflicts_with = "tls_certificate")]
    pub(crate) insecure_allow_remote: bool,
    /// Use TLS with this certificate (PEM, followed by its chain) and require a certificate from every client.
    #[arg(long, value_name = "FILE", requires_all = ["tls_key", "tls_client_ca"])]
    tls_certificate: Option<PathBuf>,
    /// Private key of --tls-certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_key: Option<PathBuf>,
    /// Certificate authority that signed the certificates of actors and operators (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_client_ca: Option<PathBuf>,
}

/// TLS files of a learner's client: its certificate and the authority that it trusts.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ClientTlsArguments {
    /// Certificate authority that signed the learner's certificate (PEM); required for an https:// URL.
    #[arg(long, value_name = "FILE", requires_all = ["tls_certificate", "tls_key"])]
    pub(crate) tls_ca: Option<PathBuf>,
    /// This client's certificate (PEM, followed by its chain); its role defines which requests are permitted.
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_certificate: Option<PathBuf>,
    /// Private key of --tls-certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_key: Option<PathBuf>,
    /// Host name in the learner's certificate [default: the host in the URL].
    #[arg(long, value_name = "NAME", requires = "tls_ca")]
    tls_server_name: Option<String>,
}

impl ServerTlsArguments {
    /// Reads the TLS files, if the arguments name them.
    ///
    /// # Errors
    /// A file is invalid.
    pub(crate) fn read(&self) -> Result<Option<ServerTls>, Usage> {
        let own = identity(self.tls_certificate.as_ref(), self.tls_key.as_ref());
        let (Some(own), Some(client_authority)) = (own, &self.tls_client_ca) else {
            return Ok(None);
        };
        let tls = ServerTls::read(&own, client_authority);
        tls.map(Some).map_err(|why| Usage::new(why.to_string()))
    }
}

impl ClientTlsArguments {
    /// Reads the TLS files, if the arguments name them.
    ///
    /// # Errors
    /// A file is invalid.
    pub(crate) fn read(&self) -> Result<Option<ClientTls>, Usage> {
        let own = identity(self.tls_certificate.as_ref(), self.tls_key.as_ref());
        let (Some(own), Some(authority)) = (own, &self.tls_ca) else { return Ok(None) };
        let tls = ClientTls::read(&own, authority, self.tls_server_name.clone());
        tls.map(Some).map_err(|why| Usage::new(why.to_string()))
    }
}

/// Reads the TLS files for a request to the learner at `url`; none for plain text.
///
/// # Errors
/// The scheme of `url` and the arguments disagree, or a file is invalid.
pub(crate) fn credentials(url: &str, tls: &ClientTlsArguments) -> Result<Option<ClientTls>, Usage> {
    match (tls.tls_ca.is_some(), url.starts_with("https://")) {
        (false, true) => Err(Usage::new(format!(
            "{url}: https:// needs --tls-ca, --tls-certificate and --tls-key"
        ))),
        (true, false) => Err(Usage::new(format!("{url}: with --tls-ca it begins with https://"))),
        (true, true) | (false, false) => tls.read(),
    }
}

fn identity(certificate: Option<&PathBuf>, key: Option<&PathBuf>) -> Option<IdentityFiles> {
    Some(IdentityFiles { certificate: certificate?.clone(), key: key?.clone() })
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

    fn arguments(page: &str) -> PageArguments {
        let access = PageAccess { page_host: Vec::new(), insecure_allow_remote_page: false };
        PageArguments { page: page.parse().unwrap(), access }
    }

    #[test]
    fn only_this_machine_reaches_plain_text_and_the_page_without_permission() {
        for page in ["127.0.0.1:8080", "[::1]:0", "[::ffff:127.0.0.1]:0"] {
            assert!(demand_loopback("--listen", page.parse().unwrap(), "").is_ok(), "{page}");
            assert!(arguments(page).check(None).is_ok(), "{page}");
        }
        assert!(arguments("off").check(None).is_ok());
        for page in ["0.0.0.0:8080", "192.168.1.2:1", "[::]:0", "[::ffff:10.0.0.1]:0"] {
            assert!(demand_loopback("--listen", page.parse().unwrap(), "").is_err(), "{page}");
            let refused = arguments(page).check(None).unwrap_err().to_string();
            assert!(refused.contains("--insecure-allow-remote-page"), "{refused}");
            let mut allowed = arguments(page);
            allowed.access.insecure_allow_remote_page = true;
            assert!(allowed.check(None).is_ok(), "{page}");
        }
        assert!("8080".parse::<PageAddress>().is_err());
    }

    #[test]
    fn a_page_is_reached_at_the_address_on_which_it_listens() {
        let access = arguments("off").access;
        let bound = access.hosts(Some("192.168.1.2".parse().unwrap())).unwrap();
        assert!(bound.allow("192.168.1.2:8080") && !bound.allow("192.168.1.3:8080"));
        let everywhere = access.hosts(Some("0.0.0.0".parse().unwrap())).unwrap();
        assert!(!everywhere.allow("0.0.0.0:8080") && everywhere.allow("localhost"));
    }

    #[test]
    fn a_learner_on_all_addresses_is_reached_on_loopback() {
        for (address, expected) in [
            ("0.0.0.0:50051", "127.0.0.1:50051"),
            ("[::]:50051", "[::1]:50051"),
            ("10.0.0.5:50051", "10.0.0.5:50051"),
            ("[::1]:50051", "[::1]:50051"),
            ("[fe80::1%2]:50051", "[fe80::1%2]:50051"),
        ] {
            assert_eq!(reachable(address.parse().unwrap()).to_string(), expected);
        }
    }

    #[tokio::test]
    async fn a_port_that_is_taken_is_named_in_one_line() {
        let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = taken.local_addr().unwrap();
        let refused = arguments(&address.to_string()).open(None).await.unwrap_err().to_string();
        assert!(refused.starts_with(&format!("--page {address}: ")), "{refused}");
        assert!(!refused.contains('\n') && refused.contains("--page off"), "{refused}");
    }
}
