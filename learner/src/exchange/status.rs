//! Where the run stands, for whoever asks.

use std::time::Duration;

use proto::{LeaseStatus, LeasedWork, Status};
use serde_json::{Value, json};

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
    /// Environment steps of one slot.
    pub(super) fn slot_steps(&self) -> u64 {
        u64::from(self.run.slot_steps) * u64::from(self.run.environments_per_slot)
    }

    /// Where the run stands.
    #[must_use]
    pub fn status(&self) -> Status {
        let storage = *self.storage.borrow();
        self.change(|_| {});
        let shared = self.lock();
        let counts = shared.table.counts();
        let (slots, complete_slots) = (counts.slots as u64, counts.complete_slots as u64);
        let slot_steps = self.slot_steps();
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
            paused: shared.table.is_paused(),
        }
    }
}

/// A status as one JSON object.
#[must_use]
pub fn status_json(status: &Status) -> Value {
    let lease = |lease: &LeaseStatus| {
        let (slot, episode) = match lease.work {
            LeasedWork::Slot(slot) => (Some(slot), None),
            LeasedWork::Episode(episode) => (None, Some(episode)),
        };
        json!({
            "lease": lease.lease.0,
            "actor": lease.actor.0,
            "slot": slot,
            "episode": episode,
            "chunks": lease.chunks,
            "still_secs": lease.still_secs,
        })
    };
    json!({
        "state": if status.paused { "paused" } else { "running" },
        "run_id": status.run_id,
        "incarnation": format!("{:016x}", status.incarnation.0),
        "iteration": status.iteration,
        "env_steps": status.env_steps,
        "env_steps_per_sec": status.env_steps_per_sec,
        "slots": status.slots,
        "complete_slots": status.complete_slots,
        "actors": status.actors,
        "messages_refused": status.messages_refused,
        "leases_reissued": status.leases_reissued,
        "storage_degraded": status.storage_degraded,
        "leases": status.leases.iter().map(lease).collect::<Vec<_>>(),
    })
}
