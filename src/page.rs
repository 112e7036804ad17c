//! The address and the access check of the run's page for `train` and `learner`.

use std::sync::Arc;

use learner::{Hosts, Page};
use security::ServerTls;
use tokio::net::TcpListener;

use crate::cli::{PageAddress, PageArguments};
use crate::errors::Usage;
use crate::listening::demand_loopback;
use crate::process::output;

/// Refuses an address that other machines can reach in plain text unless that is allowed.
pub(crate) fn check(arguments: &PageArguments, tls: Option<&Arc<ServerTls>>) -> Result<(), Usage> {
    let PageAddress::At(address) = arguments.page else { return Ok(()) };
    hosts(&arguments.page_host)?;
    if arguments.insecure_allow_remote_page || tls.is_some() {
        return Ok(());
    }
    let permission = "pass --page-tls (s2mia learner with certificates) or --insecure-allow-remote-page to allow that, \
         and --page-host with the names they use";
    demand_loopback("--page", address, permission)
}

/// Opens the page and prints its URL.
///
/// # Errors
/// The address is in use or invalid.
pub(crate) async fn open(
    arguments: &PageArguments,
    tls: Option<Arc<ServerTls>>,
) -> anyhow::Result<Option<Page>> {
    let PageAddress::At(address) = arguments.page else { return Ok(None) };
    let listener = TcpListener::bind(address).await.map_err(|error| {
        Usage::new(format!(
            "--page {address}: {error}; choose another port, or 0 for any free one, or --page off"
        ))
    })?;
    let scheme = if tls.is_some() { "https" } else { "http" };
    output::line(format!("page: {scheme}://{}", listener.local_addr()?));
    Ok(Some(Page { listener, hosts: hosts(&arguments.page_host)?, tls }))
}

/// The hosts that `--page-host` allows.
pub(crate) fn hosts(names: &[String]) -> Result<Hosts, Usage> {
    Hosts::with(names).map_err(|error| Usage::new(format!("--page-host: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(page: &str) -> PageArguments {
        let page = page.parse().unwrap();
        PageArguments { page, page_host: Vec::new(), insecure_allow_remote_page: false }
    }

    #[test]
    fn only_this_machine_sees_the_page_without_being_told() {
        for page in ["127.0.0.1:8080", "[::1]:0", "off"] {
            assert!(check(&arguments(page), None).is_ok(), "{page}");
        }
        for page in ["0.0.0.0:8080", "192.168.1.2:1", "[::]:0"] {
            let refused = check(&arguments(page), None).unwrap_err().to_string();
            assert!(refused.contains("--insecure-allow-remote-page"), "{refused}");
            let allowed = PageArguments { insecure_allow_remote_page: true, ..arguments(page) };
            assert!(check(&allowed, None).is_ok(), "{page}");
        }
        assert!("8080".parse::<PageAddress>().is_err());
    }

    #[tokio::test]
    async fn a_port_that_is_taken_is_named_in_one_line() {
        let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = taken.local_addr().unwrap();
        let refused = open(&arguments(&address.to_string()), None).await.unwrap_err().to_string();
        assert!(refused.starts_with(&format!("--page {address}: ")), "{refused}");
        assert!(!refused.contains('\n') && refused.contains("--page off"), "{refused}");
    }
}
