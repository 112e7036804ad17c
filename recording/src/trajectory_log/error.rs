//! Errors of trajectory logs.

use thiserror::Error;

use crate::error::RecordError;

/// Why a log cannot be read or written.
#[derive(Debug, Error)]
pub enum LogError {
    /// The file cannot be read.
    #[error("cannot read it: {0}")]
    Read(std::io::Error),
    /// The file is not an MCAP file.
    #[error("not an MCAP file: it does not start with the MCAP magic bytes")]
    NotMcap,
    /// The end of the file is missing.
    #[error(
        "not finished: its end is missing, so it is still being written or was truncated; `mcap recover` of the MCAP \
         command line saves the intact part"
    )]
    Unfinished,
    /// The file is corrupted.
    #[error("damaged: {0}; `mcap recover` of the MCAP command line saves the intact part")]
    Damaged(String),
    /// The file is an MCAP file, but not a trajectory log.
    #[error("an MCAP file, but not a trajectory log: {0}")]
    Foreign(String),
    /// The log cannot be replayed by this program.
    #[error("{0}")]
    Unfit(String),
    /// The output cannot be written.
    #[error(transparent)]
    Write(#[from] RecordError),
}

impl From<mcap::McapError> for LogError {
    fn from(error: mcap::McapError) -> Self {
        Self::Damaged(error.to_string())
    }
}
