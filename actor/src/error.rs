//! Errors of actors and of external environments.

use proto::{LeaseId, Refusal, in_words, name};
use sim::{SimError, StateError};
use thiserror::Error;
use tonic::{Code, Status};

/// Why an actor stopped before the end of its run.
#[derive(Debug, Error)]
pub enum ActorError {
    /// The external environment was unreachable for too long.
    #[error("no usable environment for {secs:.0} s: {last}")]
    EnvironmentOutage {
        /// Duration of the outage, seconds.
        secs: f64,
        /// Error of the last attempt.
        last: String,
    },
    /// The learner rejected a call of this actor.
    #[error("the learner rejected this actor: {}", describe(.0))]
    Refused(Status),
    /// The learner's answer violates the protocol.
    #[error("the learner's answer is invalid: {0}")]
    Answer(#[from] Refusal),
    /// The received weights are incomplete or do not match their name.
    #[error("invalid weights {version}: {why}")]
    Weights {
        /// Version of the weights.
        version: u64,
        /// Why they are invalid.
        why: String,
    },
    /// The environments cannot be built or stepped with the run's settings.
    #[error("the run's task: {0}")]
    Task(String),
    /// A start state of a lease cannot be restored.
    #[error("a start state of the lease cannot be restored: {0}")]
    StartState(StateError),
    /// An external environment failed.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// Any other failure, in words.
    #[error("{0}")]
    Other(String),
}

/// Why a request to an external environment failed.
#[derive(Debug, Error)]
pub enum EnvironmentError {
    /// The program cannot be reached or closed the stream.
    #[error("the environment at {url} {}", outcome(.status))]
    Away {
        /// URL of the environment.
        url: String,
        /// Status of the call.
        status: Box<Status>,
    },
    /// The answer does not match the environment's specification.
    #[error("the environment at {url} sent an invalid answer: {refusal}")]
    Wrong {
        /// URL of the environment.
        url: String,
        /// The field and the reason.
        refusal: Box<Refusal>,
    },
}

impl EnvironmentError {
    /// The error with the place in the episodes at which the answer was invalid.
    pub(crate) fn at(self, place: &str) -> Self {
        match self {
            Self::Wrong { url, refusal } => {
                let detail = format!("{} ({place})", refusal.detail);
                Self::Wrong { url, refusal: Box::new(Refusal { detail, ..*refusal }) }
            }
            away => away,
        }
    }
}

impl From<EnvironmentError> for SimError {
    fn from(error: EnvironmentError) -> Self {
        Self::External(Box::new(error))
    }
}

impl ActorError {
    /// The learner's URL is invalid or not allowed.
    pub(crate) fn learner_url(url: &str, why: &str) -> Self {
        Self::Other(format!("invalid learner URL {url}: {why}"))
    }

    /// The environments cannot be built with the run's settings.
    pub(crate) fn of_task(error: SimError) -> Self {
        Self::Task(error.to_string())
    }

    /// The environment's URL is invalid or not allowed, or the environment cannot be used.
    pub(crate) fn environment_url(url: &str, why: &str) -> Self {
        Self::Other(format!("cannot use {url} as an environment: {why}"))
    }

    /// Error of an actor whose environments failed with `error` during `lease`.
    pub(crate) fn of_lease(error: SimError, lease: LeaseId) -> Self {
        let external = match error {
            SimError::State(error) => return Self::StartState(error),
            SimError::External(external) => external.downcast::<EnvironmentError>(),
            own => Err(own.into()),
        };
        match external {
            Ok(error) => Self::Environment(*error),
            Err(error) => Self::Task(format!("lease {lease}: {error}")),
        }
    }
}

impl EnvironmentError {
    /// Whether the program answered that the request is invalid; a retry gives the same answer.
    pub(crate) fn is_rejection(&self) -> bool {
        let Self::Away { status, .. } = self else { return true };
        matches!(
            status.code(),
            Code::InvalidArgument
                | Code::FailedPrecondition
                | Code::OutOfRange
                | Code::NotFound
                | Code::DataLoss
        )
    }
}

/// Describes a status in one line, with the field if it names one.
pub(crate) fn describe(status: &Status) -> String {
    match Refusal::from_status(status) {
        Some(refusal) => refusal.to_string(),
        None => in_words(status),
    }
}

/// What the program did instead of answering. With INVALID_ARGUMENT it reports an error of the environment.
fn outcome(status: &Status) -> String {
    match status.code() {
        Code::InvalidArgument => format!("failed: {}", status.message()),
        _ => format!("does not answer: {}", describe(status)),
    }
}

/// Describes an error and its causes in one line, without repeating a cause that a message already includes.
#[must_use]
pub fn causes(error: &(dyn std::error::Error + 'static)) -> String {
    let folded = |error: &dyn std::error::Error| name::printable(&error.to_string());
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
    struct WithCause {
        source: std::io::Error,
    }

    #[derive(Debug, Error)]
    #[error("{0}")]
    struct Context(&'static str, #[source] Box<dyn std::error::Error>);

    #[test]
    fn a_cause_that_a_message_includes_is_not_repeated() {
        let denied = || std::io::Error::other("permission\n denied");
        let included = Context("the run", Box::new(WithCause { source: denied() }));
        assert_eq!(causes(&included), "the run: cannot read a.toml: permission denied");
        let separate = Context("cannot write b", Box::new(denied()));
        assert_eq!(causes(&separate), "cannot write b: permission denied");
    }
}
