//! What can go wrong at this crate's edge.

use thiserror::Error;

use crate::arrays::ArrayError;

/// A policy that cannot be built, trained, written or read.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// A tensor operation failed.
    #[error("tensor operation: {0}")]
    Tensor(#[from] candle_core::Error),
    /// Arrays are no arrays.
    #[error(transparent)]
    Arrays(#[from] ArrayError),
    /// Stored arrays do not fit the network.
    #[error("stored weights: {0}")]
    Restore(String),
    /// A snapshot's bytes are not a policy.
    #[error("policy snapshot: {0}")]
    Snapshot(String),
}
