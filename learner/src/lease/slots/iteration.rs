//! The slots of the open iteration: which leases they have, which are complete, and whether results agree.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::Bound;
use std::time::Duration;

use proto::{ActorId, Digest, LeaseId, RolloutWork, WeightsName};

use super::leases::OpenLease;
use super::{SlotRollout, Trust};

/// Results of ended leases kept for comparison, for each slot.
const MOST_EARLIER_RESULTS: usize = 8;
/// Leases that a slot may have at a time: the first one and a backup.
const MOST_LEASES: usize = 2;

/// The digest of a chunk, and who computed it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ComputedChunk {
    /// The actor that computed it.
    pub actor: ActorId,
    /// The lease under which it was computed.
    pub lease: LeaseId,
    /// The chunk's digest.
    pub digest: Digest,
}

/// Two valid results of one slot that differ: a machine or the program is not deterministic, or an actor lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disagreement {
    /// The iteration.
    pub iteration: u64,
    /// The slot.
    pub slot: u32,
    /// The first chunk that differs.
    pub sequence: u32,
    /// The earlier result.
    pub first: ComputedChunk,
    /// The later one.
    pub second: ComputedChunk,
}

impl fmt::Display for Disagreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { iteration, slot, sequence, first, second } = self;
        write!(
            f,
            "chunk {sequence} of slot {slot} in iteration {iteration}: actor {} gave {}, actor {} gave {}; \
             a machine or the program is not deterministic; checkpoints after iteration {iteration} may hold \
             wrong results",
            first.actor, first.digest, second.actor, second.digest
        )
    }
}

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
    /// Slots that one lease computes, by its begin.
    single: BTreeSet<(Duration, usize)>,
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
    since: Duration,
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
        let (free, single) = ((0..slots.len()).collect(), BTreeSet::new());
        Self { iteration, weights, slots, environments, free, single, complete: 0 }
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

    /// Leases to `id` the slot that has been held longest, at least since `since`, by one lease that `may_back_up`. This
    /// second lease begins `now`.
    pub(super) fn claim_backup(
        &mut self,
        id: LeaseId,
        since: Duration,
        now: Duration,
        may_back_up: impl Fn(LeaseId) -> bool,
    ) -> Option<ClaimedSlot> {
        let mut old = self.single.range(..=(since, usize::MAX)).map(|(_, index)| *index);
        let other = |index: &usize| self.slots[*index].first_lease().is_some_and(&may_back_up);
        let index = old.find(other)?;
        self.change(index, |slot| {
            if let SlotState::Held(leases) = &mut slot.state {
                leases.push(HeldLease { id, since: now });
            }
        });
        Some(self.issue(index))
    }

    /// Changes a slot, and the indexes with it.
    fn change<T>(&mut self, index: usize, change: impl FnOnce(&mut Slot) -> T) -> T {
        match &self.slots[index].state {
            SlotState::Free => {
                self.free.remove(&index);
            }
            SlotState::Held(leases) if leases.len() < MOST_LEASES => {
                self.single.remove(&(leases[0].since, index));
            }
            SlotState::Held(_) => {}
            SlotState::Complete(_) | SlotState::Taken => self.complete -= 1,
        }
        let result = change(&mut self.slots[index]);
        match &self.slots[index].state {
            SlotState::Free => {
                self.free.insert(index);
            }
            SlotState::Held(leases) if leases.len() < MOST_LEASES => {
                self.single.insert((leases[0].since, index));
            }
            SlotState::Held(_) => {}
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

    /// Earliest begin after `moment`, or of all, of the slots that are held by one lease.
    pub(super) fn first_held_after(&self, moment: Option<Duration>) -> Option<Duration> {
        let after = moment.map_or(Bound::Unbounded, |at| Bound::Excluded((at, usize::MAX)));
        self.single.range((after, Bound::Unbounded)).next().map(|(since, _)| *since)
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
    /// The oldest of its leases.
    fn first_lease(&self) -> Option<LeaseId> {
        match &self.state {
            SlotState::Held(leases) => leases.first().map(|lease| lease.id),
            _ => None,
        }
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
        let slot = self.work.slot;
        let (first, second) = (other.chunk(at), result.chunk(at));
        Some(Disagreement { iteration, slot, sequence: at as u32, first, second })
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
    fn chunk(&self, at: usize) -> ComputedChunk {
        ComputedChunk { actor: self.actor, lease: self.lease, digest: self.digests[at] }
    }
}

/// The first chunk that both have, with different digests.
pub(super) fn first_difference(one: &[Digest], other: &[Digest]) -> Option<usize> {
    one.iter().zip(other).position(|(a, b)| a != b)
}
