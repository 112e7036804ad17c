//! Accepted host names of the page. With DNS rebinding, a website could point its own name at this machine and read the
//! responses; browsers send that name in the header `Host`.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Loopback names and the hosts that the user allows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hosts(Vec<String>);

/// A text that is not a host.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no host; write a name or an address, without http:// and path")]
pub struct NotAHost(String);

impl Hosts {
    /// Accepts loopback and `more` names or addresses; ports are ignored.
    ///
    /// # Errors
    /// If one of them is not a host.
    pub fn with(more: &[String]) -> Result<Self, NotAHost> {
        let host = |text: &String| {
            let address = text.parse().ok().map(spelled);
            address.or_else(|| host(text)).ok_or_else(|| NotAHost(text.clone()))
        };
        more.iter().map(host).collect::<Result<_, _>>().map(Self)
    }

    /// Whether a `Host` header with this value is accepted, with any port.
    #[must_use]
    pub fn allow(&self, header: &str) -> bool {
        let Some(host) = host(header) else { return false };
        let is_loopback = host.parse().is_ok_and(|address: IpAddr| address.is_loopback());
        // RFC 6761, section 6.3, for the name.
        is_loopback || host == "localhost" || self.0.contains(&host)
    }
}

/// The host in `uri-host [ ":" port ]` (RFC 9110, section 7.2), a name in lower case without the dot at its end. `None`
/// for any other text.
fn host(text: &str) -> Option<String> {
    let (host, port) = match text.rsplit_once(':') {
        // The colons of an address in brackets precede no port.
        Some((host, port)) if !port.contains(']') => (host, port),
        _ => (text, ""),
    };
    if !port.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    if let Some(inside) = host.strip_prefix('[') {
        let address: Ipv6Addr = inside.strip_suffix(']')?.parse().ok()?;
        return Some(spelled(address.into()));
    }
    let absolute = host.strip_suffix('.').filter(|name| name.parse::<Ipv4Addr>().is_err());
    let name = absolute.unwrap_or(host).to_ascii_lowercase();
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
    let is_label = |label: &str| !label.is_empty() && label.bytes().all(is_plain);
    name.split('.').all(is_label).then_some(name)
}

/// The one spelling of an address. An IPv4 address that is mapped to IPv6 is the IPv4 address.
fn spelled(address: IpAddr) -> String {
    address.to_canonical().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_with_or_without_a_port_are_accepted() {
        let hosts = Hosts::default();
        for (kind, accepted) in [
            ("names", &["localhost", "LocalHost:80", "localhost.:80", "localhost:"][..]),
            ("addresses", &["127.0.0.1:8080", "127.9.9.9", "[::1]:8080", "[::1]"]),
            ("other forms of them", &["[0:0:0:0:0:0:0:1]", "[::ffff:127.0.0.1]:80"]),
        ] {
            accepted.iter().for_each(|host| assert!(hosts.allow(host), "{kind}: {host}"));
        }
        for (kind, refused) in [
            ("nothing", &["", ".", ":80"][..]),
            ("other names", &["example.org", "localhost.example.org", "example.localhost"]),
            ("two dots", &["localhost.."]),
            ("names like addresses", &["127.0.0.1.example.org:80", "127.0.0.1."]),
            ("other addresses", &["10.0.0.1", "0.0.0.0", "[2001:db8::1]:80"]),
            ("text after a bracket", &["[::1]example.org", "[::1].example.org:80"]),
            ("brackets", &["[::1", "::1", "::1]", "[[::1]]", "[localhost]", "[127.0.0.1]"]),
            ("a zone", &["[::1%lo]"]),
            ("a user", &["localhost@example.org", "example.org@localhost"]),
            ("a password", &["localhost:80@example.org"]),
            ("no port", &["localhost:example.org", "localhost:80:80", "localhost:8 0"]),
            ("a path", &["localhost/", "localhost#example.org"]),
            ("a list", &[" localhost", "localhost, example.org"]),
            ("numbers", &["2130706433", "0x7f000001", "0177.0.0.1", "127.1", "127.0.0.01"]),
        ] {
            refused.iter().for_each(|host| assert!(!hosts.allow(host), "{kind}: {host}"));
        }
    }

    #[test]
    fn hosts_that_the_user_allows_are_accepted() {
        let allowed = ["Learner", "2001:DB8:0::1", "10.0.0.5:80", "a.example.org."];
        let hosts = Hosts::with(&allowed.map(str::to_owned)).unwrap();
        for host in ["learner:50080", "[2001:db8::1]:1", "10.0.0.5", "A.example.org", "localhost"] {
            assert!(hosts.allow(host), "{host}");
        }
        assert!(!hosts.allow("learner.example.org") && !hosts.allow("example.org"));
        for wrong in ["http://learner", "learner/", "", "a b", "*", "a..b", ".", "..", ".x"] {
            assert!(Hosts::with(&[wrong.to_owned()]).is_err(), "{wrong}");
        }
    }
}
