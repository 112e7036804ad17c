//! Figures of the slot table: progress, open leases, memory.

use proto::{LeaseId, LeaseStatus};

use super::iteration::{HeldLease, OpenIteration};
use super::{ConnectionId, Counts, Footprint, SlotTable};

impl SlotTable {
    /// The table's figures.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let held = self.iteration.iter().flat_map(OpenIteration::held);
        let chunks =
            |held: &HeldLease| self.open.get(held.id).map_or(0, |lease| lease.chunks.len() as u64);
        let partial = held.map(|leases| leases.iter().map(chunks).max().unwrap_or(0)).sum::<u64>();
        let complete = self.iteration.as_ref().map_or(0, OpenIteration::complete_chunks);
        Counts {
            chunks: partial + complete,
            actors: self.actors.count(),
            foreign: self.actors.foreign,
            reissued: self.reissued,
            backups: self.backups,
            audits: self.audits.counts,
            leases: self.open.len(),
            held_slots: self.iteration.iter().flat_map(OpenIteration::held).count(),
            slot_time: self.typical.for_each_environment(),
            slots: self.iteration.as_ref().map_or(0, OpenIteration::slots),
            environments: self.iteration.as_ref().map_or(0, OpenIteration::environments),
            environments_per_slot: self.slot_environments(),
            complete_slots: self.iteration.as_ref().map_or(0, OpenIteration::complete_slots),
        }
    }

    /// Registered actors that may get work.
    #[must_use]
    pub fn actors(&self) -> usize {
        match self.rules.requires_fingerprint {
            true => self.actors.count_exact(),
            false => self.actors.count(),
        }
    }

    /// The open leases, the oldest first.
    #[must_use]
    pub fn leases(&self) -> Vec<LeaseStatus> {
        self.open.iter().map(|(id, lease)| lease.status(id, self.now)).collect()
    }

    /// The open lease with this id, if it belongs to an actor of this connection.
    #[must_use]
    pub fn lease_of(&self, connection: ConnectionId, id: LeaseId) -> Option<LeaseStatus> {
        let own = self.open.get(id).filter(|lease| lease.owner.connection == connection);
        own.map(|lease| lease.status(id, self.now))
    }

    /// Whether an actor of this connection holds a lease.
    #[must_use]
    pub fn holds_lease(&self, connection: ConnectionId) -> bool {
        let mut actors = self.actors.of(connection).into_iter();
        actors.any(|actor| self.open.of(actor).next().is_some())
    }

    /// What the table holds in memory.
    #[must_use]
    pub fn footprint(&self) -> Footprint {
        let partial = self.open.iter().map(|(_, lease)| lease.chunks.len() as u64).sum::<u64>();
        let complete = self.iteration.as_ref().map_or(0, OpenIteration::complete_chunks);
        Footprint {
            actors: self.actors.count(),
            open_leases: self.open.len(),
            finished_leases: self.finished.count(),
            chunks: partial + complete,
            earlier_results: self.iteration.as_ref().map_or(0, OpenIteration::earlier_results),
            open_audits: self.audits.open(),
        }
    }
}
