//! What is wrong with a file that the wire's security rests on. Nothing here ever shows a file's content.

use std::path::PathBuf;

/// What is wrong with a certificate, a key or an authority.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SecurityError {
    /// The file is not there, or may not be read.
    #[error("cannot read {path}: {why}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        why: String,
    },
    /// The file holds something else.
    #[error("{path} holds no {expected} in PEM form")]
    NotPem {
        /// The file.
        path: PathBuf,
        /// What should be in it.
        expected: &'static str,
    },
    /// What is between the PEM lines cannot be used.
    #[error("{path} holds a {what} that cannot be used: {why}")]
    Unusable {
        /// The file.
        path: PathBuf,
        /// Certificate or private key.
        what: &'static str,
        /// Why not.
        why: String,
    },
    /// Certificate and key are of two pairs.
    #[error("the private key {key} does not fit the certificate {certificate}")]
    OtherKey {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
    },
    /// The certificate's time is over.
    #[error("the certificate {path} expired at {at} (it is {now})")]
    Expired {
        /// The file.
        path: PathBuf,
        /// Its last moment.
        at: String,
        /// This machine's clock.
        now: String,
    },
    /// The certificate's time has not come.
    #[error("the certificate {path} is valid from {at} only (it is {now})")]
    NotYetValid {
        /// The file.
        path: PathBuf,
        /// Its first moment.
        at: String,
        /// This machine's clock.
        now: String,
    },
    /// A server name is none.
    #[error("`{name}` is neither a host name nor an IP address")]
    NoName {
        /// What was given.
        name: String,
    },
    /// New certificates could not be made.
    #[error("cannot make a certificate: {0}")]
    Unmakeable(String),
}
