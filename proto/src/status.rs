//! Status of a run, for operators and scripts.

use serde::Serialize;

use crate::name::printable;
use crate::{ActorId, Incarnation, LeaseId, wire};

/// Status of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    /// Human-readable name of the run.
    pub run_id: String,
    /// This start of the learner.
    #[serde(skip)]
    pub incarnation: Incarnation,
    /// Finished iterations.
    pub iteration: u64,
    /// Environment steps of all finished iterations and of the complete slots of the open one.
    pub env_steps: u64,
    /// Slots of the open iteration.
    pub slots: u64,
    /// Complete slots of the open iteration.
    pub complete_slots: u64,
    /// Registered actors.
    pub actors: u64,
    /// Environment steps per second in the last finished iteration, including its update; `None` before the first.
    pub env_steps_per_sec: Option<f64>,
    /// Messages rejected since the learner started.
    pub messages_refused: u64,
    /// Slots and episodes leased again since the learner started.
    pub leases_reissued: u64,
    /// Whether the last due checkpoint could not be written.
    pub storage_degraded: bool,
    /// Open leases, the oldest first.
    #[serde(skip)]
    pub leases: Vec<LeaseStatus>,
    /// Slots and evaluation episodes that got a second lease because the first was slow, since the learner started.
    pub slots_backed_up: u64,
    /// Slots and evaluation episodes that another actor computed again with an equal result, since the learner started.
    pub audits_agreed: u64,
}

/// An open lease.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeaseStatus {
    /// Id of the lease.
    pub lease: LeaseId,
    /// The actor that holds it.
    pub actor: ActorId,
    /// Its work.
    pub work: LeasedWork,
    /// Chunks received for it.
    pub chunks: u32,
    /// Seconds since its last progress.
    pub still_secs: f64,
}

/// Work of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeasedWork {
    /// A slot of the open iteration.
    Slot(u32),
    /// An episode of an evaluation.
    Episode(u32),
}

impl Status {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::GetStatusResponse {
        wire::GetStatusResponse {
            run_id: self.run_id.clone(),
            incarnation: self.incarnation.0,
            iteration: self.iteration,
            env_steps: self.env_steps,
            slots: self.slots,
            complete_slots: self.complete_slots,
            actors: self.actors,
            env_steps_per_sec: self.env_steps_per_sec,
            messages_refused: self.messages_refused,
            leases_reissued: self.leases_reissued,
            storage_degraded: self.storage_degraded,
            leases: self.leases.iter().map(|lease| lease.to_wire()).collect(),
            slots_backed_up: self.slots_backed_up,
            audits_agreed: self.audits_agreed,
        }
    }

    /// Reads the message; leases for unknown kinds of work are omitted.
    #[must_use]
    pub fn from_wire(wire: wire::GetStatusResponse) -> Self {
        Self {
            run_id: printable(&wire.run_id),
            incarnation: Incarnation(wire.incarnation),
            iteration: wire.iteration,
            env_steps: wire.env_steps,
            slots: wire.slots,
            complete_slots: wire.complete_slots,
            actors: wire.actors,
            env_steps_per_sec: wire.env_steps_per_sec,
            messages_refused: wire.messages_refused,
            leases_reissued: wire.leases_reissued,
            storage_degraded: wire.storage_degraded,
            leases: wire.leases.iter().filter_map(LeaseStatus::from_wire).collect(),
            slots_backed_up: wire.slots_backed_up,
            audits_agreed: wire.audits_agreed,
        }
    }
}

impl LeaseStatus {
    fn to_wire(self) -> wire::LeaseStatus {
        let work = match self.work {
            LeasedWork::Slot(slot) => wire::lease_status::Work::Slot(slot),
            LeasedWork::Episode(episode) => wire::lease_status::Work::Episode(episode),
        };
        wire::LeaseStatus {
            lease_id: self.lease.0,
            actor_id: self.actor.0,
            work: Some(work),
            chunks: self.chunks,
            still_secs: self.still_secs,
        }
    }

    fn from_wire(wire: &wire::LeaseStatus) -> Option<Self> {
        let work = match wire.work? {
            wire::lease_status::Work::Slot(slot) => LeasedWork::Slot(slot),
            wire::lease_status::Work::Episode(episode) => LeasedWork::Episode(episode),
        };
        Some(Self {
            lease: LeaseId(wire.lease_id),
            actor: ActorId(wire.actor_id),
            work,
            chunks: wire.chunks,
            still_secs: wire.still_secs,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_survives_the_round_trip() {
        let lease = |id, work| LeaseStatus {
            lease: LeaseId(id),
            actor: ActorId(2),
            work,
            chunks: 1,
            still_secs: 0.5,
        };
        let status = Status {
            run_id: "a run".to_owned(),
            incarnation: Incarnation(3),
            iteration: 4,
            env_steps: 500,
            slots: 10,
            complete_slots: 6,
            actors: 2,
            env_steps_per_sec: Some(1234.5),
            messages_refused: 7,
            leases_reissued: 8,
            storage_degraded: true,
            leases: vec![lease(11, LeasedWork::Slot(6)), lease(12, LeasedWork::Episode(0))],
            slots_backed_up: 9,
            audits_agreed: 10,
        };
        assert_eq!(Status::from_wire(status.to_wire()), status);
    }
}
