//! Settings of one actor process; operational, so they never change a number.

use security::{ClientFiles, addresses};
use tonic::transport::Uri;

use crate::error::ActorError;
use crate::trajectory_log::LogConfig;

/// Where the learner is and how long to wait for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// The learner's URL, such as `http://127.0.0.1:50051`.
    pub learner: String,
    /// What is spoken with it.
    pub transport: Transport,
    /// URL of the program that offers the environment; `None`: the simulator does.
    pub environment: Option<String>,
    /// Seconds without the learner after which the actor gives up.
    pub max_outage_secs: f64,
    /// Name of this actor, for people.
    pub name: String,
    /// Where and what it logs, if anything.
    pub log: Option<LogConfig>,
}

/// What is spoken with the learner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transport {
    /// Plain text, as long as it stays on this machine.
    PlainTextOnLoopback,
    /// Plain text, wherever the learner is.
    PlainText,
    /// TLS, with certificates on both sides.
    Tls(ClientFiles),
}

impl Config {
    /// Refuses a URL that is none, plain text to another machine unless that is allowed, and certificates
    /// that cannot be used.
    ///
    /// # Errors
    /// Says what is wrong and what to give instead.
    pub fn validate(&self) -> Result<(), ActorError> {
        let wrong = |why: &str| ActorError::Url { url: self.learner.clone(), why: why.to_owned() };
        let url: Uri = self.learner.parse().map_err(|_| wrong("write http://HOST:50051"))?;
        let (scheme, host) = (url.scheme_str(), url.host().unwrap_or_default());
        match (&self.transport, scheme) {
            (Transport::Tls(files), Some("https")) => files.read().map(drop).map_err(Into::into),
            (Transport::Tls(_), _) => Err(wrong("with --tls-ca it begins with https://")),
            (_, Some("https")) => {
                Err(wrong("https:// needs --tls-ca, --tls-certificate and --tls-key"))
            }
            (Transport::PlainText, Some("http")) => Ok(()),
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

/// Refuses a URL of an environment that is none. What is spoken with it is plain text, which leaves this machine only
/// with [`Transport::PlainText`].
///
/// # Errors
/// Says what is wrong and what to give instead.
pub fn check_environment(url: &str, transport: &Transport) -> Result<(), ActorError> {
    let wrong =
        |why: &str| Err(ActorError::EnvironmentUrl { url: url.to_owned(), why: why.to_owned() });
    let Ok(parsed) = url.parse::<Uri>() else { return wrong("write http://HOST:PORT") };
    let local = addresses::is_loopback(parsed.host().unwrap_or_default());
    match parsed.scheme_str() {
        Some("http") if local || *transport == Transport::PlainText => Ok(()),
        Some("http") => wrong(
            "it is another machine, and environments are stepped in plain text; start one on this machine, or \
             pass --insecure-allow-remote to learner and actor",
        ),
        _ => wrong("write http://HOST:PORT"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(learner: &str, transport: Transport) -> String {
        let config = Config {
            learner: learner.to_owned(),
            transport,
            environment: None,
            max_outage_secs: 1.0,
            name: "a".into(),
            log: None,
        };
        config.validate().map_or_else(|error| error.to_string(), |()| "accepted".to_owned())
    }

    #[test]
    fn plain_text_leaves_this_machine_only_on_request() {
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
    fn an_environment_is_stepped_in_plain_text_and_on_this_machine_unless_told_otherwise() {
        let told = |url: &str, transport: &Transport| {
            check_environment(url, transport).map_err(|error| error.to_string())
        };
        assert_eq!(told("http://[::1]:7", &Transport::PlainTextOnLoopback), Ok(()));
        assert_eq!(told("http://gpu-box:7", &Transport::PlainText), Ok(()));
        for (url, why) in [
            ("http://gpu-box:7", "another machine"),
            ("https://localhost:7", "write http://HOST:PORT"),
            ("localhost:7", "write http://HOST:PORT"),
        ] {
            let line = told(url, &Transport::PlainTextOnLoopback).unwrap_err();
            assert!(line.contains(why), "{line}");
        }
    }

    #[test]
    fn scheme_and_certificates_go_together() {
        let line = refusal("https://learner:1", Transport::PlainText);
        assert!(line.contains("needs --tls-ca"), "{line}");
        for url in ["localhost:50051", "localhost", "ftp://localhost", ""] {
            let line = refusal(url, Transport::PlainTextOnLoopback);
            assert!(line.contains("is no URL of a learner: write http://"), "{line}");
        }
    }
}
