//! Errors of certificate files. No message contains the contents of a file.

use std::path::PathBuf;

/// An invalid certificate, key or authority.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SecurityError {
    /// The operating system provides no randomness for a token.
    #[error("the operating system provides no randomness for the run's token")]
    NoRandomness,
    /// Text that is no token.
    #[error("a token has 64 hexadecimal digits; copy it from the file `token` of the run folder")]
    NoToken,
    /// The file cannot be read.
    #[error("cannot read {path}: {why}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        why: String,
    },
    /// The file does not contain the expected PEM section.
    #[error("{path} holds no {expected} in PEM form")]
    NotPem {
        /// The file.
        path: PathBuf,
        /// The expected section.
        expected: &'static str,
    },
    /// The contents of the PEM section are invalid.
    #[error("{path} holds a {what} that cannot be used: {why}")]
    Unusable {
        /// The file.
        path: PathBuf,
        /// Certificate or private key.
        what: &'static str,
        /// Reason.
        why: String,
    },
    /// Certificate and key do not belong together.
    #[error("the private key {key} does not fit the certificate {certificate}")]
    OtherKey {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
    },
    /// The certificate has expired.
    #[error("the certificate {path} expired at {at} (it is {now})")]
    Expired {
        /// The file.
        path: PathBuf,
        /// End of its validity.
        at: String,
        /// Time of this machine.
        now: String,
    },
    /// The certificate is not valid yet.
    #[error("the certificate {path} is valid from {at} only (it is {now})")]
    NotYetValid {
        /// The file.
        path: PathBuf,
        /// Start of its validity.
        at: String,
        /// Time of this machine.
        now: String,
    },
    /// A server name is invalid.
    #[error("`{name}` is neither a host name nor an IP address")]
    NoName {
        /// The name.
        name: String,
    },
    /// A certificate could not be created.
    #[error("cannot make a certificate: {0}")]
    Unmakeable(String),
}
