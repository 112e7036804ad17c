//! Why the trainer wakes up, and why the exchange cannot continue.

use proto::RolloutOrigin;

use crate::lease::slots::{EvaluationOutcome, SlotRollout};

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
    /// The wait timed out.
    Timeout,
}

/// Why the exchange cannot continue: weights that are no policy of the run, results that differ, or work at which all
/// actors failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ExchangeError(pub String);
