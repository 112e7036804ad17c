//! A slot or an episode: its leases, its result, and earlier results for comparison.

use std::sync::Arc;
use std::time::Duration;

use proto::{EvaluationResult, LeaseId, Work};

use super::SlotRollout;
use super::disagreement::{Computed, Disagreement};

/// Results of ended leases kept for comparison, for each slot.
const MOST_EARLIER_RESULTS: usize = 8;

/// A slot or an episode.
#[derive(Debug)]
pub(super) struct Item {
    pub(super) work: Arc<Work>,
    /// Leases so far.
    pub(super) issued: u32,
    pub(super) state: ItemState,
    /// Digests from ended leases, from the first chunk on.
    pub(super) earlier: Vec<EarlierResult>,
}

/// What happens to an item, in this order. A lost lease makes it free again.
#[derive(Debug)]
pub(super) enum ItemState {
    /// It has no lease.
    Free,
    /// These leases compute it, the oldest first; two if the first one is slow.
    Held(Vec<HeldLease>),
    /// Its result is complete.
    Complete(Output),
    /// The trainer has its result.
    Taken,
}

#[derive(Debug)]
pub(super) enum Output {
    Slot(SlotRollout),
    Episode(EvaluationResult),
}

/// A lease of a slot or an episode, and when it began.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldLease {
    pub(super) id: LeaseId,
    pub(super) since: Duration,
}

#[derive(Clone, Debug)]
pub(super) struct EarlierResult {
    pub(super) computed: Computed,
    pub(super) complete: bool,
}

impl Item {
    /// Adds a lease to the first one. The second lease that was there before.
    pub(super) fn add_backup(&mut self, lease: HeldLease) -> Option<LeaseId> {
        let ItemState::Held(leases) = &mut self.state else { return None };
        let replaced = leases.split_off(1);
        leases.push(lease);
        replaced.first().map(|replaced| replaced.id)
    }

    pub(super) fn drop_lease(&mut self, id: LeaseId) {
        if let ItemState::Held(leases) = &mut self.state {
            leases.retain(|lease| lease.id != id);
            if leases.is_empty() {
                self.state = ItemState::Free;
            }
        }
    }

    pub(super) fn is_confirmed(&self, result: &Computed) -> bool {
        let confirms =
            |other: &EarlierResult| other.complete && other.computed.digests == result.digests;
        self.earlier.iter().any(confirms)
    }

    pub(super) fn is_contradicted(&self, result: &Computed) -> bool {
        let mut earlier = self.earlier.iter();
        earlier.any(|other| other.computed.first_difference(result).is_some())
    }

    pub(super) fn complete_contradiction(&self, result: &Computed) -> Option<Disagreement> {
        let other = self.earlier.iter().find(|other| other.complete)?;
        Disagreement::between(&self.work, &other.computed, result)
    }

    /// Keeps a result that adds to what is known. Complete results are never pushed out.
    pub(super) fn remember(&mut self, result: EarlierResult) {
        let digests = &result.computed.digests;
        let known = |other: &EarlierResult| other.computed.digests.starts_with(digests);
        if !result.complete && self.earlier.iter().any(known) || digests.is_empty() {
            return;
        }
        if self.earlier.len() == MOST_EARLIER_RESULTS {
            let oldest = self.earlier.iter().position(|other| !other.complete);
            oldest.map(|at| self.earlier.remove(at));
        }
        self.earlier.push(result);
    }
}

/// The begin of the latest of the leases of an item.
pub(super) fn latest(leases: &[HeldLease]) -> Duration {
    leases.last().map_or(Duration::ZERO, |lease| lease.since)
}
