//! Figures of the slot table: progress, open leases, memory.

use proto::LeaseStatus;

use super::item::HeldLease;
use super::works::{Group, Works};
use super::{ConnectionId, Counts, SlotTable};

impl SlotTable {
    /// The table's figures.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let chunks =
            |held: &HeldLease| self.open.get(held.id).map_or(0, |lease| lease.chunks.len() as u64);
        let most = |leases: &[HeldLease]| leases.iter().map(chunks).max().unwrap_or(0);
        let slots = self.works.get(&Group::Slots);
        let partial: u64 = slots.map_or(0, |slots| slots.held().map(most).sum());
        let complete = slots.map_or(0, Works::complete_chunks);
        let held: u64 = self.open.iter().map(|(_, lease)| lease.chunks.len() as u64).sum();
        Counts {
            chunks: partial + complete,
            held_chunks: held + complete,
            actors: self.actors.count(),
            foreign: self.actors.foreign,
            reissued: self.reissued,
            backups: self.backups,
            audits: self.audits.counts,
            open_audits: self.audits.open_slots(),
            leases: self.open.len(),
            finished_leases: self.finished.count(),
            earlier_results: slots.map_or(0, Works::earlier_results),
            held_slots: slots.map_or(0, |slots| slots.held().count()),
            slot_time: self.times.slots.for_each_environment(),
            slots: slots.map_or(0, Works::len),
            environments: slots.map_or(0, |slots| slots.environments),
            environments_per_slot: slots.map_or(0, |slots| slots.item_environments),
            complete_slots: slots.map_or(0, |slots| slots.complete),
        }
    }

    /// Registered actors that may get work.
    #[must_use]
    pub fn actors(&self) -> usize {
        if self.rules.requires_fingerprint {
            self.actors.count_exact()
        } else {
            self.actors.count()
        }
    }

    /// The open leases, the oldest first.
    #[must_use]
    pub fn leases(&self) -> Vec<LeaseStatus> {
        self.open.iter().map(|(id, lease)| lease.status(id, self.now)).collect()
    }

    /// Whether an actor of this connection holds a lease.
    pub(crate) fn holds_lease(&self, connection: ConnectionId) -> bool {
        let mut actors = self.actors.of(connection).into_iter();
        actors.any(|actor| self.open.of(actor).next().is_some())
    }
}
