//! Why the trainer wakes up, and why the exchange cannot continue.

use proto::{PolicyVersion, RolloutOrigin};

use crate::lease::slots::{Disagreement, EvaluationOutcome, SlotRollout};

/// Why the trainer woke up.
#[derive(Clone, Debug, PartialEq)]
pub enum Wake {
    /// The open iteration is complete.
    Iteration {
        /// Every slot, in order.
        rollouts: Vec<SlotRollout>,
        /// From the opening of its slots to the last chunk.
        secs: f64,
    },
    /// An evaluation is complete.
    Evaluation(EvaluationOutcome),
    /// The start states of this slot cannot be used ([`super::Exchange::replace`]).
    BeginAgain(RolloutOrigin),
    /// The run cannot continue.
    Failed(ExchangeError),
    /// Nothing happened for as long as it was willing to wait.
    Patience,
}

/// Why the exchange cannot continue.
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
