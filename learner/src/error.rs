//! Why a run could not start, continue or end.

use std::path::PathBuf;

use crate::lease::exchange::ExchangeError;
use crate::store::checkpoint::CheckpointError;
use crate::store::durable::FileError;
use crate::store::run_folder::RunFolderError;

/// Why a run could not start, continue or end.
#[derive(Debug, thiserror::Error)]
pub enum LearnerError {
    /// The sizes contradict each other, or would not fit a message.
    #[error("the run cannot be described to actors; the field of the message is {0}")]
    Description(#[source] proto::Refusal),
    /// The run folder cannot be used.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A checkpoint could not be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The checkpoint is past the iteration at which this run should end.
    #[error("{path} stands at iteration {found}, past the {iterations} that this run should have")]
    PastTheEnd {
        /// The checkpoint.
        path: PathBuf,
        /// Its iteration.
        found: u64,
        /// Iterations asked for.
        iterations: u64,
    },
    /// Actors' results contradict each other, or weights could not be published.
    #[error(transparent)]
    Exchange(#[from] ExchangeError),
    /// The algorithm failed.
    #[error(transparent)]
    Training(#[from] marl::MarlError),
    /// A file of the run folder could not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// A thread or a pool could not be started.
    #[error("cannot start {what}: {detail}")]
    Threads {
        /// The thread or pool.
        what: &'static str,
        /// Why.
        detail: String,
    },
    /// The service broke down, so no actor could be served any more.
    #[error("the service ended: {0}")]
    Service(String),
    /// The trainer's thread panicked.
    #[error("the trainer panicked: {0}")]
    Panic(String),
}
