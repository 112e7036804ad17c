//! What ends an actor before its run is done.

use proto::{LeaseId, Refusal, in_words};
use security::SecurityError;
use sim::SimError;
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
    #[error("no session with {url} for {secs:.0} s; last try: {last}")]
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
    /// The URL of the environment is none, or it offers what cannot be stepped.
    #[error("{url} is no URL of an environment: {why}")]
    EnvironmentUrl {
        /// What was given.
        url: String,
        /// Why it is none.
        why: String,
    },
    /// Whoever steps the environments failed.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// The log's settings or folder cannot be used.
    #[error("{0}")]
    Log(String),
    /// The stepping thread ended by itself.
    #[error("the stepping thread ended: {0}")]
    Stepping(String),
}

/// Why a program that steps environments did not do what it was asked.
#[derive(Debug, Error)]
pub enum EnvironmentError {
    /// The program that offers the environment cannot be reached, or broke off.
    #[error("the environment at {url} does not answer: {}", describe(.status))]
    Away {
        /// Its URL.
        url: String,
        /// How the call ended.
        status: Box<Status>,
    },
    /// Its answer does not fit what it says of itself.
    #[error("the environment at {url} answers wrongly: {refusal}")]
    Wrong {
        /// Its URL.
        url: String,
        /// The field and what is wrong with it.
        refusal: Box<Refusal>,
    },
}

impl From<EnvironmentError> for SimError {
    fn from(error: EnvironmentError) -> Self {
        Self::External(Box::new(error))
    }
}

impl ActorError {
    /// What ends an actor whose environments failed with `error` while it worked on `lease`.
    pub(crate) fn of_lease(error: SimError, lease: LeaseId) -> Self {
        let external = match error {
            SimError::External(external) => external.downcast::<EnvironmentError>(),
            own => Err(own.into()),
        };
        match external {
            Ok(error) => Self::Environment(*error),
            Err(error) => Self::Task(format!("lease {lease}: {error}")),
        }
    }
}

/// A status as one line, with the field if it names one.
pub(crate) fn describe(status: &Status) -> String {
    match Refusal::from_status(status) {
        Some(refusal) => refusal.to_string(),
        None => in_words(status),
    }
}

/// An error with what caused it, in one line; a cause that the text before it ends with is not told again.
#[must_use]
pub fn causes(error: &(dyn std::error::Error + 'static)) -> String {
    let folded = |error: &dyn std::error::Error| {
        error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let mut line = folded(error);
    let mut source = error.source();
    while let Some(cause) = source {
        let text = folded(cause);
        if !line.ends_with(&text) {
            line = format!("{line}: {text}");
        }
        source = cause.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Error)]
    #[error("cannot read a.toml: {source}")]
    struct Told {
        source: std::io::Error,
    }

    #[derive(Debug, Error)]
    #[error("{0}")]
    struct In(&'static str, #[source] Box<dyn std::error::Error>);

    #[test]
    fn a_cause_that_is_told_already_is_told_once() {
        let denied = || std::io::Error::other("permission\n denied");
        let told = In("the run", Box::new(Told { source: denied() }));
        assert_eq!(causes(&told), "the run: cannot read a.toml: permission denied");
        let untold = In("cannot write b", Box::new(denied()));
        assert_eq!(causes(&untold), "cannot write b: permission denied");
    }
}
