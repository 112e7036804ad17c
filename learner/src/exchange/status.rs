//! Where the run stands, for whoever asks.

use std::time::Duration;

use proto::Status;

use crate::exchange::{Exchange, Storage};

/// When the last iterations were opened.
#[derive(Debug, Default)]
pub(super) struct Pace {
    iteration: u64,
    opened: Option<Duration>,
    /// How long the iteration before the open one took.
    took: Option<Duration>,
}

impl Pace {
    pub(super) fn open(&mut self, iteration: u64, now: Duration) {
        self.took = self.opened.map(|before| now - before);
        self.opened = Some(now);
        self.iteration = iteration;
    }

    /// How long the open iteration has been open, seconds.
    pub(super) fn secs_open(&self, now: Duration) -> f64 {
        self.opened.map_or(0.0, |opened| (now - opened).as_secs_f64())
    }
}

impl Exchange {
    /// Where the run stands.
    #[must_use]
    pub fn status(&self) -> Status {
        let storage = *self.storage.borrow();
        self.change(|_| {});
        let shared = self.lock();
        let counts = shared.table.counts();
        let (slots, complete_slots) = (counts.slots as u64, counts.complete_slots as u64);
        let slot_steps = u64::from(self.run.slot_steps) * u64::from(self.run.environments_per_slot);
        let iteration = shared.pace.iteration;
        let per_sec = |took: Duration| (slots * slot_steps) as f64 / took.as_secs_f64();
        Status {
            run_id: self.run.run_id.clone(),
            incarnation: self.run.incarnation,
            iteration: shared.weights.newest().map_or(0, |version| version.0),
            env_steps: (iteration * slots + complete_slots) * slot_steps,
            slots,
            complete_slots,
            actors: counts.actors as u64,
            env_steps_per_sec: shared.pace.took.map(per_sec),
            messages_refused: shared.refusals.values().sum(),
            leases_reissued: counts.reissued,
            storage_degraded: storage == Storage::Degraded,
            leases: shared.table.leases(),
        }
    }
}
