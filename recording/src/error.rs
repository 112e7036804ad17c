//! Errors of recordings and of logs being written.

use sim::SimError;
use thiserror::Error;

/// Why an episode cannot be recorded.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The file cannot be written or read.
    #[error("cannot write the file: {0}")]
    File(#[from] std::io::Error),
    /// The MCAP library returned an error.
    #[error("MCAP: {0}")]
    Format(#[from] mcap::McapError),
    /// The environment cannot be built or stepped.
    #[error(transparent)]
    Episode(#[from] SimError),
    /// The written file contains a different number of messages.
    #[error("the file contains {found} messages, but {written} were written")]
    Verification {
        /// Messages written.
        written: u64,
        /// Messages read.
        found: u64,
    },
}
