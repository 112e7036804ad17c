//! The slots of the open iteration: which leases they have, which are complete, and whether results agree.

use std::collections::BTreeSet;
use std::ops::Bound;
use std::time::Duration;

use proto::{ActorId, Digest, LeaseId, RolloutWork, WeightsName};

use super::disagreement::{ComputedPart, Disagreement, Part};
use super::leases::OpenLease;
use super::{SlotRollout, Trust};

/// Results of ended leases kept for comparison, for each slot.
const MOST_EARLIER_RESULTS: usize = 8;

/// What a complete result does.
pub(super) enum Completion {
    /// It is the slot's result.
    Accepted,
    /// An unfinished result contradicts it: the slot is computed once more.
    Disputed,
    /// A complete result contradicts it.
    Failed(Disagreement),
}

/// The open iteration. Slots change only in [`Self::change`], which keeps the indexes.
#[derive(Debug)]
pub(super) struct OpenIteration {
    pub(super) iteration: u64,
    pub(super) weights: WeightsName,
    slots: Vec<Slot>,
    /// Environments of all slots, and of the largest.
    environments: (usize, usize),
    /// Indices of the slots without a lease.
    free: BTreeSet<usize>,
    /// The slots with a lease, by the begin of the latest one.
    held: BTreeSet<(Duration, usize)>,
    /// Slots whose result is complete, those that the trainer took included.
    complete: usize,
}

#[derive(Debug)]
struct Slot {
    work: RolloutWork,
    /// Leases so far.
    issued: u32,
    state: SlotState,
    earlier: Vec<EarlierResult>,
}

/// What happens to a slot, in this order. A lost lease makes it free again.
#[derive(Debug)]
enum SlotState {
    /// It has no lease.
    Free,
    /// These leases compute it, the oldest first; two if the first one is slow.
    Held(Vec<HeldLease>),
    /// Its result is there.
    Complete(SlotRollout),
    /// The trainer has its result.
    Taken,
}

/// A lease of a slot, and when it began.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldLease {
    pub(super) id: LeaseId,
    pub(super) since: Duration,
}

/// Digests from an ended lease, from the first chunk on.
#[derive(Clone, Debug)]
struct EarlierResult {
    actor: ActorId,
    lease: LeaseId,
    digests: Vec<Digest>,
    complete: bool,
}

/// A slot given out.
pub(super) struct ClaimedSlot {
    pub(super) index: usize,
    pub(super) work: RolloutWork,
    /// How often it was leased before.
    pub(super) attempt: u32,
}

impl OpenIteration {
    pub(super) fn new(iteration: u64, weights: WeightsName, works: Vec<RolloutWork>) -> Self {
        let sizes = works.iter().map(|work: &RolloutWork| work.environments.len());
        let environments = (sizes.clone().sum(), sizes.max().unwrap_or(0));
        let slot = |work| Slot { work, issued: 0, state: SlotState::Free, earlier: Vec::new() };
        let slots = works.into_iter().map(slot).collect::<Vec<_>>();
        let (free, held) = ((0..slots.len()).collect(), BTreeSet::new());
        Self { iteration, weights, slots, environments, free, held, complete: 0 }
    }

    /// The lowest free slot that `may_try` permits.
    pub(super) fn claim(
        &mut self,
        id: LeaseId,
        now: Duration,
        may_try: impl Fn(usize) -> bool,
    ) -> Option<ClaimedSlot> {
        let index = self.free.iter().copied().find(|index| may_try(*index))?;
        let held = SlotState::Held(vec![HeldLease { id, since: now }]);
        self.change(index, |slot| slot.state = held);
        Some(self.issue(index))
    }

    /// Leases to `id` the slot whose latest lease began first, at `since` or before, of those that `may_be_backed_up`,
    /// given their leases and the number of these so far. This lease begins `now`. A second one that the slot has already is
    /// replaced; it is returned.
    pub(super) fn claim_backup(
        &mut self,
        id: LeaseId,
        since: Duration,
        now: Duration,
        may_be_backed_up: impl Fn(usize, &[HeldLease], u32) -> bool,
    ) -> Option<(ClaimedSlot, Option<LeaseId>)> {
        let mut old = self.held.range(..=(since, usize::MAX)).map(|(_, index)| *index);
        let index = old.find(|index| match &self.slots[*index] {
            Slot { state: SlotState::Held(leases), issued, .. } => {
                may_be_backed_up(*index, leases, *issued)
            }
            _ => false,
        })?;
        let replaced = self.change(index, |slot| slot.add_backup(HeldLease { id, since: now }));
        Some((self.issue(index), replaced))
    }

    /// Changes a slot, and the indexes with it.
    fn change<T>(&mut self, index: usize, change: impl FnOnce(&mut Slot) -> T) -> T {
        match &self.slots[index].state {
            SlotState::Free => {
                self.free.remove(&index);
            }
            SlotState::Held(leases) => {
                self.held.remove(&(latest(leases), index));
            }
            SlotState::Complete(_) | SlotState::Taken => self.complete -= 1,
        }
        let result = change(&mut self.slots[index]);
        match &self.slots[index].state {
            SlotState::Free => {
                self.free.insert(index);
            }
            SlotState::Held(leases) => {
                self.held.insert((latest(leases), index));
            }
            SlotState::Complete(_) | SlotState::Taken => self.complete += 1,
        }
        result
    }

    fn issue(&mut self, index: usize) -> ClaimedSlot {
        let slot = &mut self.slots[index];
        slot.issued += 1;
        ClaimedSlot { index, work: slot.work.clone(), attempt: slot.issued - 1 }
    }

    /// The leases of each held slot.
    pub(super) fn held(&self) -> impl Iterator<Item = &[HeldLease]> {
        self.slots.iter().filter_map(|slot| match &slot.state {
            SlotState::Held(leases) => Some(leases.as_slice()),
            _ => None,
        })
    }

    /// Earliest begin after `moment`, or of all, of the latest leases of the slots.
    pub(super) fn first_held_after(&self, moment: Option<Duration>) -> Option<Duration> {
        let after = moment.map_or(Bound::Unbounded, |at| Bound::Excluded((at, usize::MAX)));
        self.held.range((after, Bound::Unbounded)).next().map(|(since, _)| *since)
    }

    /// The slot at this index.
    pub(super) fn work(&self, index: usize) -> &RolloutWork {
        &self.slots[index].work
    }

    /// The other leases of the slot besides `id`.
    pub(super) fn other_leases(&self, index: usize, id: LeaseId) -> Vec<LeaseId> {
        match &self.slots[index].state {
            SlotState::Held(leases) => {
                leases.iter().map(|lease| lease.id).filter(|other| *other != id).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Replaces a slot that no lease computes. Results from its former start states are forgotten.
    pub(super) fn replace(&mut self, index: usize, work: RolloutWork) {
        let slot = &mut self.slots[index];
        slot.earlier.clear();
        slot.work = work;
    }

    /// The lease ended before its result was complete.
    pub(super) fn release(&mut self, index: usize, id: LeaseId, lease: OpenLease) {
        let slot = self.without_lease(index, id);
        if lease.owner.trust == Trust::Exact {
            let (actor, digests) = (lease.owner.actor, lease.digests);
            slot.remember(EarlierResult { actor, lease: id, digests, complete: false });
        }
    }

    /// The lease's result is complete. Other leases of the slot have been released.
    pub(super) fn complete(&mut self, index: usize, id: LeaseId, lease: OpenLease) -> Completion {
        let iteration = self.iteration;
        let slot = self.without_lease(index, id);
        let OpenLease { owner, digests, chunks, .. } = lease;
        let actor = owner.actor;
        let result = EarlierResult { actor, lease: id, digests, complete: true };
        if owner.trust == Trust::Exact && !slot.is_confirmed(&result) {
            if let Some(disagreement) = slot.complete_contradiction(&result, iteration) {
                return Completion::Failed(disagreement);
            }
            if slot.is_contradicted(&result) {
                slot.remember(result);
                return Completion::Disputed;
            }
        }
        let (slot_index, digests) = (slot.work.slot, result.digests);
        let rollout = SlotRollout { slot: slot_index, actor, lease: id, chunks, digests };
        slot.earlier.clear();
        self.change(index, |slot| slot.state = SlotState::Complete(rollout));
        Completion::Accepted
    }

    /// The slot after the end of one of its leases.
    fn without_lease(&mut self, index: usize, id: LeaseId) -> &mut Slot {
        self.change(index, |slot| slot.drop_lease(id));
        &mut self.slots[index]
    }

    /// All rollouts by slot, once, when none is missing.
    pub(super) fn take_if_complete(&mut self) -> Option<Vec<SlotRollout>> {
        if self.complete < self.slots.len() {
            return None;
        }
        let taken = self.slots.iter_mut().map(|slot| {
            match std::mem::replace(&mut slot.state, SlotState::Taken) {
                SlotState::Complete(rollout) => Some(rollout),
                _ => None,
            }
        });
        taken.collect()
    }

    pub(super) fn slots(&self) -> usize {
        self.slots.len()
    }

    /// Whether a slot has no lease.
    pub(super) fn any_free(&self) -> bool {
        !self.free.is_empty()
    }

    /// Environments of all slots.
    pub(super) fn environments(&self) -> usize {
        self.environments.0
    }

    /// Environments of the largest slot.
    pub(super) fn slot_environments(&self) -> usize {
        self.environments.1
    }

    /// Slots whose result is complete, those that the trainer took included.
    pub(super) fn complete_slots(&self) -> usize {
        self.complete
    }

    pub(super) fn earlier_results(&self) -> usize {
        self.slots.iter().map(|slot| slot.earlier.len()).sum()
    }

    pub(super) fn complete_chunks(&self) -> u64 {
        let chunks = self.slots.iter().filter_map(|slot| match &slot.state {
            SlotState::Complete(rollout) => Some(rollout.chunks.len() as u64),
            _ => None,
        });
        chunks.sum()
    }
}

impl Slot {
    /// Adds a lease to the first one. The second lease that was there before.
    fn add_backup(&mut self, lease: HeldLease) -> Option<LeaseId> {
        let SlotState::Held(leases) = &mut self.state else { return None };
        let replaced = leases.split_off(1);
        leases.push(lease);
        replaced.first().map(|replaced| replaced.id)
    }

    fn drop_lease(&mut self, id: LeaseId) {
        if let SlotState::Held(leases) = &mut self.state {
            leases.retain(|lease| lease.id != id);
            if leases.is_empty() {
                self.state = SlotState::Free;
            }
        }
    }

    fn is_confirmed(&self, result: &EarlierResult) -> bool {
        self.earlier.iter().any(|other| other.complete && other.digests == result.digests)
    }

    fn is_contradicted(&self, result: &EarlierResult) -> bool {
        self.earlier.iter().any(|other| first_difference(&other.digests, &result.digests).is_some())
    }

    fn complete_contradiction(
        &self,
        result: &EarlierResult,
        iteration: u64,
    ) -> Option<Disagreement> {
        let other = self.earlier.iter().find(|other| other.complete)?;
        let at = first_difference(&other.digests, &result.digests)?;
        let part = Part::Chunk { slot: self.work.slot, sequence: at as u32 };
        let (first, second) = (other.chunk(at), result.chunk(at));
        Some(Disagreement { iteration, part, first, second })
    }

    /// Keeps a result that adds to what is known. Complete results are never pushed out.
    fn remember(&mut self, result: EarlierResult) {
        let known = |other: &EarlierResult| other.digests.starts_with(&result.digests);
        if !result.complete && self.earlier.iter().any(known) || result.digests.is_empty() {
            return;
        }
        if self.earlier.len() == MOST_EARLIER_RESULTS {
            let oldest = self.earlier.iter().position(|other| !other.complete);
            oldest.map(|at| self.earlier.remove(at));
        }
        self.earlier.push(result);
    }
}

impl EarlierResult {
    fn chunk(&self, at: usize) -> ComputedPart {
        ComputedPart { actor: self.actor, lease: self.lease, digest: self.digests[at] }
    }
}

/// The first chunk that both have, with different digests.
pub(super) fn first_difference(one: &[Digest], other: &[Digest]) -> Option<usize> {
    one.iter().zip(other).position(|(a, b)| a != b)
}

/// The begin of the latest of the leases of a slot.
fn latest(leases: &[HeldLease]) -> Duration {
    leases.last().map_or(Duration::ZERO, |lease| lease.since)
}
