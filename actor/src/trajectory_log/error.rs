//! What is wrong with a log.

use thiserror::Error;

use crate::recording::RecordError;

/// Why a log cannot be read or written.
#[derive(Debug, Error)]
pub enum LogError {
    /// The file cannot be read.
    #[error("cannot read it: {0}")]
    Read(std::io::Error),
    /// The file is of another kind.
    #[error("no MCAP file: it does not begin as one")]
    NotMcap,
    /// The file has no end.
    #[error(
        "not finished: its end is missing, so it is still being written or was cut off; \
         `s2mia log recover` saves what is whole"
    )]
    Unfinished,
    /// The file's bytes contradict each other.
    #[error("damaged: {0}; `s2mia log recover` saves what is whole")]
    Damaged(String),
    /// An MCAP file of something else.
    #[error("an MCAP file, but no trajectory log: {0}")]
    Foreign(String),
    /// The log cannot be continued or repeated here.
    #[error("{0}")]
    Unfit(String),
    /// The output cannot be written.
    #[error(transparent)]
    Write(#[from] RecordError),
    /// The output is there already; it may be the input.
    #[error("is there already; name another file")]
    Taken,
}

impl From<mcap::McapError> for LogError {
    fn from(error: mcap::McapError) -> Self {
        Self::Damaged(error.to_string())
    }
}
