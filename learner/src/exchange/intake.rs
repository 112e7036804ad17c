//! What actors send, counted.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::exchange::Exchange;

/// Counts since the learner started.
#[derive(Debug, Default)]
pub(super) struct Intake {
    bytes: AtomicU64,
    log_steps_lost: AtomicU64,
}

impl Intake {
    /// Bytes of results.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Steps that actors' trajectory logs lost.
    pub(super) fn log_steps_lost(&self) -> u64 {
        self.log_steps_lost.load(Ordering::Relaxed)
    }
}

impl Exchange {
    /// A message with results came in, fit or not.
    pub fn count_bytes(&self, bytes: usize) {
        self.intake.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// An actor's trajectory log lost `steps`. An actor may claim any number, which stops at the highest there is.
    pub fn count_lost_log_steps(&self, steps: u64) {
        let add = |before: u64| Some(before.saturating_add(steps));
        let added =
            self.intake.log_steps_lost.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add);
        added.expect("there is always a sum");
    }
}
