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

#[cfg(test)]
mod tests {
    use super::*;

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
