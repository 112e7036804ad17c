//! The hosts with which plain text is permitted by default.

use std::net::IpAddr;

/// Whether `host` of a URL is certainly this machine: a loopback address, or `localhost` (RFC 6761, section 6.3). Any
/// other name may resolve to another machine.
#[must_use]
pub fn is_loopback(host: &str) -> bool {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let address = bare.parse::<IpAddr>().map(|address| address.to_canonical());
    address.map_or(bare.eq_ignore_ascii_case("localhost"), |address| address.is_loopback())
}

/// What names the host in a URL or in `HOST:PORT`: with its port, and with what is before `@`.
fn authority(url: &str) -> &str {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    rest.split(['/', '?', '#']).next().unwrap_or_default()
}

/// The host of a URL or of `HOST:PORT`, an IPv6 address without its brackets.
#[must_use]
pub fn host(url: &str) -> &str {
    let authority = authority(url);
    let host = authority.rsplit_once('@').map_or(authority, |(_, host)| host);
    let (address, end) = host.strip_prefix('[').map_or((host, ':'), |address| (address, ']'));
    address.split(end).next().unwrap_or(address)
}

/// The port of a URL is not a number from 0 to 65535.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the port {0} is not a number from 0 to 65535")]
pub struct InvalidPort(pub String);

/// Checks the port of `HOST:PORT` or of a URL, if it has one. URL parsers accept larger numbers, and clients then use
/// the default port.
///
/// # Errors
/// If the port is not a number from 0 to 65535.
pub fn check_port(url: &str) -> Result<(), InvalidPort> {
    // An address in brackets contains colons.
    let after_host = authority(url).rsplit(['@', ']']).next().unwrap_or_default();
    match after_host.rsplit_once(':') {
        Some((_, port)) if port.parse::<u16>().is_err() => Err(InvalidPort(port.to_owned())),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_below_65536() {
        for url in ["http://[::1]:50051/", "127.0.0.1:0", "https://learner", "http://[::1]", ""] {
            assert_eq!(check_port(url), Ok(()), "{url}");
        }
        for (url, port) in [
            ("http://127.0.0.1:65536", "65536"),
            ("http://a@[::1]:99999/x", "99999"),
            ("learner:x", "x"),
            ("learner:", ""),
        ] {
            assert_eq!(check_port(url), Err(InvalidPort(port.to_owned())), "{url}");
        }
    }

    #[test]
    fn the_host_has_neither_user_nor_port_nor_path() {
        for (url, expected) in [
            ("http://user:word@learner:50051/a:b@c", "learner"),
            ("https://[::1]:50051", "::1"),
            ("10.0.0.5:50051", "10.0.0.5"),
            ("learner", "learner"),
            ("http://127.0.0.1#@example.org", "127.0.0.1"),
        ] {
            assert_eq!(host(url), expected, "{url}");
        }
    }

    #[test]
    fn only_this_machine_is_loopback() {
        for host in ["127.0.0.1", "127.9.9.9", "::1", "[::1]", "[::ffff:127.0.0.1]", "LocalHost"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in ["0.0.0.0", "[::]", "10.0.0.1", "learner", "localhost.example.org", ""] {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
