//! Operational settings of an actor process, which never affect results.

use recording::trajectory_log::LogConfig;
use security::{ClientTls, Token, addresses};
use tonic::transport::Uri;

use crate::error::ActorError;

/// Settings of an actor process.
#[derive(Clone, Debug)]
pub struct ActorConfig {
    /// URL of the learner, such as `http://127.0.0.1:50051`.
    pub learner: String,
    /// Transport of the connection.
    pub transport: Transport,
    /// Token of the run, if the learner requires one.
    pub token: Option<Token>,
    /// URL of the program that provides the environment; `None` for the simulator.
    pub environment: Option<String>,
    /// Longest outage of the learner before the actor stops, seconds.
    pub max_outage_secs: f64,
    /// Display name of this actor.
    pub name: String,
    /// Number of threads that step slots, at least 1; each is registered separately.
    pub threads: usize,
    /// Version and commit of the program.
    pub build: String,
    /// Settings of the trajectory log, if enabled.
    pub log: Option<LogConfig>,
}

/// Transport of the connection to the learner.
#[derive(Clone, Debug)]
pub enum Transport {
    /// Plain text, only on this machine.
    PlainTextOnLoopback,
    /// Plain text, to any machine.
    PlainText,
    /// TLS, with certificates on both sides.
    Tls(ClientTls),
}

impl ActorConfig {
    /// Checks the learner's URL and the transport.
    ///
    /// # Errors
    /// If the URL is invalid, or plain text to another machine is not allowed.
    pub fn validate(&self) -> Result<(), ActorError> {
        let wrong = |why: &str| ActorError::learner_url(&self.learner, why);
        addresses::check_port(&self.learner).map_err(|port| wrong(&port.to_string()))?;
        let url: Uri = self.learner.parse().map_err(|_| wrong("write http://HOST:50051"))?;
        let scheme = url.scheme_str();
        let host = url.host().unwrap_or_default();
        match (&self.transport, scheme) {
            (Transport::Tls(_), Some("https")) | (Transport::PlainText, Some("http")) => Ok(()),
            (Transport::Tls(_), _) => Err(wrong("with --tls-ca it must start with https://")),
            (_, Some("https")) => {
                Err(wrong("https:// needs --tls-ca, --tls-certificate and --tls-key"))
            }
            (Transport::PlainTextOnLoopback, Some("http")) if addresses::is_loopback(host) => {
                Ok(())
            }
            (Transport::PlainTextOnLoopback, Some("http")) => Err(wrong(
                "it is on another machine, and plain text is neither encrypted nor authenticated; use https:// with \
                 --tls-ca, --tls-certificate and --tls-key, or pass --insecure-allow-remote",
            )),
            _ => Err(wrong("write http://HOST:50051 or https://HOST:50051")),
        }
    }
}

/// Checks the URL of an external environment. The connection is plain text, which is allowed to another machine only
/// with [`Transport::PlainText`].
///
/// # Errors
/// If the URL is invalid or the machine is not allowed.
pub fn check_environment(url: &str, transport: &Transport) -> Result<(), ActorError> {
    let wrong = |why: &str| Err(ActorError::environment_url(url, why));
    let Ok(parsed) = url.parse::<Uri>() else { return wrong("write http://HOST:PORT") };
    if let Err(port) = addresses::check_port(url) {
        return wrong(&port.to_string());
    }
    let local = addresses::is_loopback(parsed.host().unwrap_or_default());
    match parsed.scheme_str() {
        Some("http") if local || matches!(transport, Transport::PlainText) => Ok(()),
        Some("http") => wrong(
            "it is on another machine, and the connection is plain text; start it on this machine, or use \
             `s2mia learner` and `s2mia actor` with --insecure-allow-remote",
        ),
        _ => wrong("write http://HOST:PORT"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(learner: &str, transport: Transport) -> String {
        let config = ActorConfig {
            learner: learner.to_owned(),
            transport,
            token: None,
            environment: None,
            max_outage_secs: 1.0,
            build: String::new(),
            name: "a".into(),
            threads: 1,
            log: None,
        };
        config.validate().map_or_else(|error| error.to_string(), |()| "accepted".to_owned())
    }

    #[test]
    fn the_refusal_of_an_environment_names_the_commands_that_can_allow_it() {
        let checked = check_environment("http://10.0.0.9:2", &Transport::PlainTextOnLoopback);
        let line = checked.unwrap_err().to_string();
        let advice = "or use `s2mia learner` and `s2mia actor` with --insecure-allow-remote";
        assert!(line.ends_with(advice), "{line}");
    }

    #[test]
    fn plain_text_to_another_machine_needs_a_flag_and_the_scheme_must_match_the_certificates() {
        use Transport::{PlainText, PlainTextOnLoopback};
        let (port, another) = ("the port 70000 is not a number from 0 to 65535", "another machine");
        let (scheme, http) = (": write http://HOST:50051", "write http://HOST:PORT");
        for (url, transport, learner, environment) in [
            ("http://127.0.0.1:1", PlainTextOnLoopback, "accepted", "accepted"),
            ("http://localhost:1", PlainTextOnLoopback, "accepted", "accepted"),
            ("http://[::1]:1", PlainTextOnLoopback, "accepted", "accepted"),
            ("http://10.0.0.1:1", PlainTextOnLoopback, another, another),
            ("http://10.0.0.1:1", PlainText, "accepted", "accepted"),
            ("http://learner:1", PlainTextOnLoopback, another, another),
            ("http://learner:1", PlainText, "accepted", "accepted"),
            ("http://localhost@learner:1", PlainTextOnLoopback, another, another),
            ("http://localhost@learner:1", PlainText, "accepted", "accepted"),
            ("https://learner:1", PlainText, "needs --tls-ca", http),
            ("http://localhost:70000", PlainTextOnLoopback, port, port),
            ("localhost:50051", PlainTextOnLoopback, scheme, http),
            ("localhost", PlainTextOnLoopback, scheme, http),
            ("ftp://localhost", PlainTextOnLoopback, scheme, http),
            ("", PlainTextOnLoopback, "invalid learner URL", http),
        ] {
            let checked = check_environment(url, &transport);
            let line = checked.map_or_else(|error| error.to_string(), |()| "accepted".to_owned());
            assert!(line.contains(environment), "{url}: {line}");
            let line = refusal(url, transport);
            assert!(line.contains(learner), "{url}: {line}");
        }
    }
}
