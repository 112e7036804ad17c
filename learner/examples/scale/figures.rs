//! What a simulation counts, and the figures that follow from it.

use std::time::Duration;

/// Sums over the measured iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Totals {
    /// Complete iterations.
    pub(crate) iterations: u64,
    /// Slots whose result the trainer got.
    pub(crate) slots: u64,
    /// Simulated time.
    pub(crate) elapsed: Duration,
    /// From the opening of an iteration to its last chunk.
    pub(crate) rollouts: Duration,
    /// Actors' time in which they step.
    pub(crate) busy: Duration,
    /// Actors' time in which their machines are away.
    pub(crate) away: Duration,
    /// Failures of machines.
    pub(crate) failures: u64,
    /// Slots leased again after their lease had ended.
    pub(crate) reissued: u64,
    /// Backup leases.
    pub(crate) backups: u64,
    /// Time in which a call holds the table's lock.
    pub(crate) locked: Duration,
}

impl Totals {
    /// Mean duration of an iteration, seconds.
    pub(crate) fn iteration_secs(&self) -> f64 {
        self.elapsed.as_secs_f64() / self.iterations as f64
    }

    /// Share of the learner's time in which it waits for rollouts.
    pub(crate) fn rollout_share(&self) -> f64 {
        self.rollouts.as_secs_f64() / self.elapsed.as_secs_f64()
    }

    /// Share of the living actors' time in which they do not step.
    pub(crate) fn idle_share(&self, actors: usize) -> f64 {
        let alive = self.elapsed.as_secs_f64() * actors as f64 - self.away.as_secs_f64();
        1.0 - self.busy.as_secs_f64() / alive
    }

    /// Share of the time in which the table's lock is held.
    pub(crate) fn locked_share(&self) -> f64 {
        self.locked.as_secs_f64() / self.elapsed.as_secs_f64()
    }
}
