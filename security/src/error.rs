//! Errors of certificate files and tokens. No message contains the contents of a file.

/// What is wrong with a certificate, key, authority or token, in words.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SecurityError(pub(crate) String);
