//! What ends an actor before its run is done.

use proto::Refusal;
use security::SecurityError;
use thiserror::Error;
use tonic::Status;

/// Why an actor gave up.
#[derive(Debug, Error)]
pub enum ActorError {
    /// The learner's URL is none.
    #[error("{url} is no URL of a learner: {why}")]
    Url {
        /// What was given.
        url: String,
        /// Why it is none.
        why: String,
    },
    /// Plain text would leave this machine.
    #[error(
        "{url} is another machine, and plain text is neither encrypted nor does it say who listens; use \
         https:// with --tls-ca, --tls-certificate and --tls-key, or pass --insecure-allow-remote"
    )]
    PlainText {
        /// The learner's URL.
        url: String,
    },
    /// A certificate or a key of this actor cannot be used.
    #[error(transparent)]
    Credentials(#[from] SecurityError),
    /// The two sides do not agree on TLS, or one refuses the other's certificate.
    #[error("no session with {url}: {why}")]
    Tls {
        /// The learner's URL.
        url: String,
        /// What to change.
        why: String,
    },
    /// The learner was out of reach for too long.
    #[error("no learner at {url} for {secs:.0} s; last try: {last}")]
    Outage {
        /// Its URL.
        url: String,
        /// Seconds without it.
        secs: f64,
        /// What the last try ended with.
        last: String,
    },
    /// The learner does not want this actor.
    #[error("the learner refuses this actor: {}", describe(.0))]
    Refused(Status),
    /// The learner sent what breaks the protocol.
    #[error("the learner's answer is wrong: {0}")]
    Answer(#[from] Refusal),
    /// The weights' bytes are not what their name says.
    #[error("weights {version}: {why}")]
    Weights {
        /// Version in the lease.
        version: u64,
        /// What is wrong with them.
        why: String,
    },
    /// The environments cannot be built from the run's settings.
    #[error("the run's task: {0}")]
    Task(String),
    /// The log's settings or folder cannot be used.
    #[error("{0}")]
    Log(String),
    /// The stepping thread ended by itself.
    #[error("the stepping thread ended: {0}")]
    Stepping(String),
}

/// A status as one line, with the field if it names one.
pub(crate) fn describe(status: &Status) -> String {
    match Refusal::from_status(status) {
        Some(refusal) => refusal.to_string(),
        None => format!("{:?}: {}", status.code(), status.message()),
    }
}
