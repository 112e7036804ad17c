//! Why the exchange cannot go on.

use proto::PolicyVersion;

use crate::slots::Disagreement;

/// Why the exchange cannot go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExchangeError {
    /// What should be published is no policy for this run.
    #[error("cannot publish weights {version}: {detail}")]
    Weights {
        /// Their version.
        version: PolicyVersion,
        /// What is wrong with them.
        detail: String,
    },
    /// Two valid results differ.
    #[error("{0}")]
    Disagreement(Box<Disagreement>),
    /// All actors failed at the same work.
    #[error(
        "{work} failed {times} times and no actor could finish it, the last was {actor}: {detail}; remove the cause, \
         then resume the run"
    )]
    Work {
        /// The work.
        work: String,
        /// How often it failed.
        times: u32,
        /// The last actor that failed.
        actor: String,
        /// The last cause.
        detail: String,
    },
}
