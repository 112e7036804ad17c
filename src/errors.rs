//! Errors that end the program with a status of their own.

/// Arguments or settings that cannot be used; the program ends with status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Usage(String);

impl Usage {
    /// One line that says what is wrong and what to do.
    pub(crate) fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }
}

/// Status of an actor whose external environment was unreachable for too long; another actor would not reach it either.
pub(crate) const ENVIRONMENT_OUTAGE: u8 = 4;

/// The output is valid, but some input was missing; the program ends with status 3.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Incomplete(pub(crate) String);
