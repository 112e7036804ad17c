//! Why a run could not start, continue or end.

use crate::lease::exchange::ExchangeError;
use crate::store::checkpoint::CheckpointError;
use crate::store::durable::FileError;
use crate::store::run_folder::RunFolderError;

/// Why a run could not start, continue or end.
#[derive(Debug, thiserror::Error)]
pub enum LearnerError {
    /// The run folder cannot be used.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A checkpoint could not be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Actors' results contradict each other, or weights could not be published.
    #[error(transparent)]
    Exchange(#[from] ExchangeError),
    /// The algorithm failed.
    #[error(transparent)]
    Training(#[from] marl::MarlError),
    /// A file of the run folder could not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// Any other failure, in words.
    #[error("{0}")]
    Other(String),
}
