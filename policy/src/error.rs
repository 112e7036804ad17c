//! Errors of this crate.

use thiserror::Error;

use crate::arrays::ArrayError;

/// A policy cannot be built, trained, encoded or decoded.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// A tensor operation failed.
    #[error("tensor operation: {0}")]
    Tensor(#[from] candle_core::Error),
    /// Arrays cannot be encoded or decoded.
    #[error(transparent)]
    Arrays(#[from] ArrayError),
    /// Stored arrays do not match the network.
    #[error("stored weights: {0}")]
    Restore(String),
    /// The bytes are not a valid policy snapshot.
    #[error("policy snapshot: {0}")]
    Snapshot(String),
}
