//! The open iteration's slots: who holds which, what is complete, and whether results agree.

use std::fmt;

use proto::{ActorId, Digest, LeaseId, RolloutWork, WeightsName};

use super::leases::OpenLease;
use super::{SlotRollout, Trust};

/// Digests of unfinished leases kept for comparison, for each slot.
const MOST_WITNESSES: usize = 8;

/// What one lease gave for a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Testimony {
    /// Who computed it.
    pub actor: ActorId,
    /// Under which lease.
    pub lease: LeaseId,
    /// What came out.
    pub digest: Digest,
}

/// Two complete, valid results of one slot that differ: a machine or the program is not deterministic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disagreement {
    /// The iteration.
    pub iteration: u64,
    /// The slot.
    pub slot: u32,
    /// The first chunk that differs.
    pub sequence: u32,
    /// The earlier result.
    pub first: Testimony,
    /// The later one.
    pub second: Testimony,
}

impl fmt::Display for Disagreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { iteration, slot, sequence, first, second } = self;
        write!(
            f,
            "chunk {sequence} of slot {slot} in iteration {iteration}: actor {} gave {}, actor {} gave {}; \
             a machine or the program is not deterministic",
            first.actor, first.digest, second.actor, second.digest
        )
    }
}

/// What a complete result amounts to.
pub(super) enum Verdict {
    /// It is the slot's result.
    Stands,
    /// Something unfinished contradicts it: the slot is computed once more.
    Disputed,
    /// A complete result contradicts it.
    Failed(Disagreement),
}

/// The open iteration.
#[derive(Debug)]
pub(super) struct Board {
    iteration: u64,
    pub(super) weights: WeightsName,
    slots: Vec<Slot>,
}

#[derive(Debug)]
struct Slot {
    work: RolloutWork,
    issued: u32,
    holder: Option<LeaseId>,
    witnesses: Vec<Witness>,
    rollout: Option<SlotRollout>,
    taken: bool,
}

/// Digests that an ended lease gave, from the first chunk on.
#[derive(Clone, Debug)]
struct Witness {
    actor: ActorId,
    lease: LeaseId,
    digests: Vec<Digest>,
    complete: bool,
}

impl Board {
    pub(super) fn new(iteration: u64, weights: WeightsName, works: Vec<RolloutWork>) -> Self {
        let slot = |work| Slot {
            work,
            issued: 0,
            holder: None,
            witnesses: Vec::new(),
            rollout: None,
            taken: false,
        };
        Self { iteration, weights, slots: works.into_iter().map(slot).collect() }
    }

    /// The lowest free slot, and how often it was leased before.
    pub(super) fn claim(&mut self, id: LeaseId) -> Option<(usize, RolloutWork, u32)> {
        let free = |slot: &Slot| slot.holder.is_none() && slot.rollout.is_none() && !slot.taken;
        let index = self.slots.iter().position(free)?;
        let slot = &mut self.slots[index];
        slot.holder = Some(id);
        slot.issued += 1;
        Some((index, slot.work.clone(), slot.issued - 1))
    }

    /// The lease ended before its result was complete.
    pub(super) fn release(&mut self, index: usize, id: LeaseId, lease: OpenLease) {
        let slot = &mut self.slots[index];
        slot.holder = None;
        if lease.trust == Trust::Exact {
            let OpenLease { actor, digests, .. } = lease;
            slot.remember(Witness { actor, lease: id, digests, complete: false });
        }
    }

    /// The lease's result is complete.
    pub(super) fn complete(&mut self, index: usize, id: LeaseId, lease: OpenLease) -> Verdict {
        let iteration = self.iteration;
        let slot = &mut self.slots[index];
        slot.holder = None;
        let OpenLease { actor, trust, digests, chunks, .. } = lease;
        let witness = Witness { actor, lease: id, digests, complete: true };
        if trust == Trust::Exact && !slot.seconded(&witness) {
            if let Some(disagreement) = slot.complete_contradiction(&witness, iteration) {
                return Verdict::Failed(disagreement);
            }
            if slot.contradicted(&witness) {
                slot.remember(witness);
                return Verdict::Disputed;
            }
        }
        let digests = witness.digests;
        slot.rollout =
            Some(SlotRollout { slot: slot.work.slot, actor, lease: id, chunks, digests });
        slot.witnesses.clear();
        Verdict::Stands
    }

    /// All rollouts by slot, once, when none is missing.
    pub(super) fn take_if_complete(&mut self) -> Option<Vec<SlotRollout>> {
        if self.slots.iter().any(|slot| slot.rollout.is_none()) {
            return None;
        }
        self.slots.iter_mut().for_each(|slot| slot.taken = true);
        self.slots.iter_mut().map(|slot| slot.rollout.take()).collect()
    }

    pub(super) fn slots(&self) -> usize {
        self.slots.len()
    }

    /// Slots whose result is complete, those that the trainer took included.
    pub(super) fn complete_slots(&self) -> usize {
        self.slots.iter().filter(|slot| slot.taken || slot.rollout.is_some()).count()
    }

    pub(super) fn witnesses(&self) -> usize {
        self.slots.iter().map(|slot| slot.witnesses.len()).sum()
    }

    pub(super) fn complete_chunks(&self) -> u64 {
        self.slots
            .iter()
            .filter_map(|slot| slot.rollout.as_ref())
            .map(|r| r.chunks.len() as u64)
            .sum()
    }
}

impl Slot {
    fn seconded(&self, result: &Witness) -> bool {
        self.witnesses.iter().any(|other| other.complete && other.digests == result.digests)
    }

    fn contradicted(&self, result: &Witness) -> bool {
        self.witnesses.iter().any(|other| first_difference(other, result).is_some())
    }

    fn complete_contradiction(&self, result: &Witness, iteration: u64) -> Option<Disagreement> {
        let other = self.witnesses.iter().find(|other| other.complete)?;
        let at = first_difference(other, result)?;
        let slot = self.work.slot;
        let (first, second) = (other.testimony(at), result.testimony(at));
        Some(Disagreement { iteration, slot, sequence: at as u32, first, second })
    }

    /// Keeps what adds to what is known. Complete results are never pushed out.
    fn remember(&mut self, witness: Witness) {
        let known = |other: &Witness| other.digests.starts_with(&witness.digests);
        if !witness.complete && self.witnesses.iter().any(known) || witness.digests.is_empty() {
            return;
        }
        if self.witnesses.len() == MOST_WITNESSES {
            let oldest = self.witnesses.iter().position(|other| !other.complete);
            oldest.map(|at| self.witnesses.remove(at));
        }
        self.witnesses.push(witness);
    }
}

impl Witness {
    fn testimony(&self, at: usize) -> Testimony {
        Testimony { actor: self.actor, lease: self.lease, digest: self.digests[at] }
    }
}

/// The first chunk that both gave, differently.
fn first_difference(one: &Witness, other: &Witness) -> Option<usize> {
    one.digests.iter().zip(&other.digests).position(|(a, b)| a != b)
}
