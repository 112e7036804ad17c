//! Accepted host names of the page. With DNS rebinding, a website could point its own name at this machine and read the
//! responses; browsers send that name in the header `Host`.

use security::addresses;

/// Loopback names and the hosts that the user allows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hosts(Vec<String>);

impl Hosts {
    /// Accepts loopback and `more` names or addresses; ports are ignored.
    #[must_use]
    pub fn with(more: &[String]) -> Self {
        Self(more.iter().map(|name| bare(name).to_ascii_lowercase()).collect())
    }

    /// Whether a `Host` header with this value is accepted, with any port.
    #[must_use]
    pub fn allow(&self, host: &str) -> bool {
        let name = bare(host).to_ascii_lowercase();
        addresses::is_loopback(&name) || self.0.contains(&name)
    }
}

/// A host without its port and without the brackets of an IPv6 address.
fn bare(host: &str) -> &str {
    if let Some(rest) = host.strip_prefix('[') {
        return rest.split(']').next().unwrap_or_default();
    }
    match host.split_once(':') {
        // More than one colon without brackets means an IPv6 address.
        Some((name, port)) if !port.contains(':') => name,
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_loopback_names_are_accepted_and_other_hosts_are_not() {
        let hosts = Hosts::default();
        for host in
            ["localhost", "LocalHost:80", "127.0.0.1:8080", "127.9.9.9", "[::1]:8080", "[::1]"]
        {
            assert!(hosts.allow(host), "{host}");
        }
        for host in [
            "",
            "example.org",
            "localhost.example.org",
            "127.0.0.1.example.org:80",
            "10.0.0.1",
            "0.0.0.0",
            "[2001:db8::1]:80",
        ] {
            assert!(!hosts.allow(host), "{host}");
        }
    }

    #[test]
    fn hosts_that_the_user_allows_are_accepted() {
        let hosts = Hosts::with(&["Learner".to_owned(), "2001:db8::1".to_owned()]);
        assert!(hosts.allow("learner:50080") && hosts.allow("[2001:db8::1]:1"));
        assert!(hosts.allow("localhost") && !hosts.allow("learner.example.org"));
    }
}
