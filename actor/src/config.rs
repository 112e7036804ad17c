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
        let wrong = |why: &str| ActorError::Url { url: self.learner.clone(), why: why.to_owned() };
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
            (Transport::PlainTextOnLoopback, Some("http")) => {
                Err(ActorError::PlainText { url: self.learner.clone() })
            }
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
    let wrong =
        |why: &str| Err(ActorError::EnvironmentUrl { url: url.to_owned(), why: why.to_owned() });
    let Ok(parsed) = url.parse::<Uri>() else { return wrong("write http://HOST:PORT") };
    if let Err(port) = addresses::check_port(url) {
        return wrong(&port.to_string());
    }
    let local = addresses::is_loopback(parsed.host().unwrap_or_default());
    match parsed.scheme_str() {
        Some("http") if local || matches!(transport, Transport::PlainText) => Ok(()),
        Some("http") => wrong(
            "it is on another machine, and the connection is plain text; start it on this machine, or pass \
             --insecure-allow-remote to learner and actor",
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
    fn plain_text_to_another_machine_needs_a_flag() {
        for url in ["http://127.0.0.1:1", "http://localhost:1", "http://[::1]:1"] {
            assert_eq!(refusal(url, Transport::PlainTextOnLoopback), "accepted", "{url}");
        }
        for url in ["http://10.0.0.1:1", "http://learner:1", "http://localhost@learner:1"] {
            let line = refusal(url, Transport::PlainTextOnLoopback);
            assert!(line.contains("another machine"), "{line}");
            assert_eq!(refusal(url, Transport::PlainText), "accepted", "{url}");
        }
    }

    #[test]
    fn an_environment_uses_plain_text_and_must_be_local_without_a_flag() {
        let check = |url: &str, transport: &Transport| {
            check_environment(url, transport).map_err(|error| error.to_string())
        };
        assert_eq!(check("http://[::1]:7", &Transport::PlainTextOnLoopback), Ok(()));
        assert_eq!(check("http://gpu-box:7", &Transport::PlainText), Ok(()));
        for (url, why) in [
            ("http://gpu-box:7", "another machine"),
            ("https://localhost:7", "write http://HOST:PORT"),
            ("localhost:7", "write http://HOST:PORT"),
            ("http://localhost:70000", "the port 70000 is not a number from 0 to 65535"),
        ] {
            let line = check(url, &Transport::PlainTextOnLoopback).unwrap_err();
            assert!(line.contains(why), "{line}");
        }
    }

    #[test]
    fn the_scheme_must_match_the_certificates() {
        let line = refusal("https://learner:1", Transport::PlainText);
        assert!(line.contains("needs --tls-ca"), "{line}");
        let line = refusal("http://localhost:70000", Transport::PlainTextOnLoopback);
        assert!(line.contains("the port 70000 is not"), "{line}");
        for url in ["localhost:50051", "localhost", "ftp://localhost", ""] {
            let line = refusal(url, Transport::PlainTextOnLoopback);
            assert!(
                line.contains("invalid learner URL") && line.contains(": write http://"),
                "{line}"
            );
        }
    }
}
