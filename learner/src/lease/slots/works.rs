//! Work that is complete together, the slots of the open iteration or the episodes of an evaluation: which leases each
//! slot or episode has, whether its result is complete, and whether results agree.

use std::collections::BTreeSet;
use std::ops::Bound;
use std::sync::Arc;
use std::time::Duration;

use proto::{EvaluationWork, LeaseId, RolloutWork, WeightsName, Work};

use super::disagreement::{Computed, Disagreement};
use super::item::{EarlierResult, HeldLease, Item, ItemState, Output, latest};
use super::leases::{Claim, Claimed, OpenLease};
use super::{Effect, EvaluationOutcome, SlotRollout, Trust};

/// The slots of the open iteration, which are leased first, or the episodes of the evaluation of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Group {
    Slots,
    Evaluation(u64),
}

/// A slot or an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key {
    pub(super) group: Group,
    /// Index in the group.
    pub(super) index: usize,
}

/// What a complete result does.
pub(super) enum Completion {
    /// It is the result of its slot or episode.
    Accepted,
    /// An unfinished result contradicts it: the slot is computed once more.
    Disputed,
    /// A complete result contradicts it.
    Failed(Disagreement),
}

/// The work of a group. Items change only in [`Self::change`], which keeps the indexes.
#[derive(Debug)]
pub(super) struct Works {
    pub(super) group: Group,
    pub(super) weights: WeightsName,
    items: Vec<Item>,
    /// Environments of all items.
    pub(super) environments: usize,
    /// Environments of the largest item; an episode has one.
    pub(super) item_environments: usize,
    /// Indices of the items without a lease.
    free: BTreeSet<usize>,
    /// The items with a lease, by the begin of the latest one.
    held: BTreeSet<(Duration, usize)>,
    /// Items whose result is complete, those that the trainer took included.
    pub(super) complete: usize,
}

impl Works {
    /// The slots of an iteration.
    pub(super) fn slots(weights: WeightsName, slots: Vec<RolloutWork>) -> Self {
        Self::new(Group::Slots, weights, slots.into_iter().map(Work::Rollout))
    }

    /// The episodes of the evaluation of an iteration.
    pub(super) fn episodes(iteration: u64, weights: WeightsName, episodes: u32) -> Self {
        let work = |episode| Work::Evaluation(EvaluationWork { iteration, episode });
        Self::new(Group::Evaluation(iteration), weights, (0..episodes).map(work))
    }

    fn new(group: Group, weights: WeightsName, works: impl Iterator<Item = Work>) -> Self {
        let item = |work| Item {
            work: Arc::new(work),
            issued: 0,
            state: ItemState::Free,
            earlier: Vec::new(),
        };
        let items = works.map(item).collect::<Vec<_>>();
        let sizes = items.iter().map(|item| environments(&item.work));
        Self {
            group,
            weights,
            environments: sizes.clone().sum(),
            item_environments: sizes.max().unwrap_or(0),
            free: (0..items.len()).collect(),
            held: BTreeSet::new(),
            complete: 0,
            items,
        }
    }

    /// The first free item that `may_try` permits.
    pub(super) fn claim(
        &mut self,
        id: LeaseId,
        now: Duration,
        may_try: impl Fn(Key) -> bool,
    ) -> Option<Claimed> {
        let group = self.group;
        let permitted = |index: &usize| may_try(Key { group, index: *index });
        let index = self.free.iter().copied().find(permitted)?;
        let held = ItemState::Held(vec![HeldLease { id, since: now }]);
        self.change(index, |item| item.state = held);
        Some(self.issue(index))
    }

    /// Leases to `id` the item whose latest lease began first, at `since` or before, of those that `may_be_backed_up`,
    /// given their leases and the number of these so far. This lease begins `now`. A second one that the item has already is
    /// replaced; it is returned.
    pub(super) fn claim_backup(
        &mut self,
        id: LeaseId,
        since: Duration,
        now: Duration,
        may_be_backed_up: impl Fn(Key, &[HeldLease], u32) -> bool,
    ) -> Option<(Claimed, Option<LeaseId>)> {
        let group = self.group;
        let mut old = self.held.range(..=(since, usize::MAX)).map(|(_, index)| *index);
        let index = old.find(|index| match &self.items[*index] {
            Item { state: ItemState::Held(leases), issued, .. } => {
                may_be_backed_up(Key { group, index: *index }, leases, *issued)
            }
            _ => false,
        })?;
        let replaced = self.change(index, |item| item.add_backup(HeldLease { id, since: now }));
        Some((self.issue(index), replaced))
    }

    /// Changes an item, and the indexes with it.
    fn change<T>(&mut self, index: usize, change: impl FnOnce(&mut Item) -> T) -> T {
        match &self.items[index].state {
            ItemState::Free => {
                self.free.remove(&index);
            }
            ItemState::Held(leases) => {
                self.held.remove(&(latest(leases), index));
            }
            ItemState::Complete(_) | ItemState::Taken => self.complete -= 1,
        }
        let result = change(&mut self.items[index]);
        match &self.items[index].state {
            ItemState::Free => {
                self.free.insert(index);
            }
            ItemState::Held(leases) => {
                self.held.insert((latest(leases), index));
            }
            ItemState::Complete(_) | ItemState::Taken => self.complete += 1,
        }
        result
    }

    fn issue(&mut self, index: usize) -> Claimed {
        let (group, weights) = (self.group, self.weights);
        let item = &mut self.items[index];
        item.issued += 1;
        let work = Arc::clone(&item.work);
        let attempt = item.issued - 1;
        Claimed { claim: Claim::Result(Key { group, index }), weights, work, attempt }
    }

    /// The leases of each held item.
    pub(super) fn held(&self) -> impl Iterator<Item = &[HeldLease]> {
        self.items.iter().filter_map(|item| match &item.state {
            ItemState::Held(leases) => Some(leases.as_slice()),
            _ => None,
        })
    }

    /// Earliest begin after `moment`, or of all, of the latest leases of the items.
    pub(super) fn first_held_after(&self, moment: Option<Duration>) -> Option<Duration> {
        let after = moment.map_or(Bound::Unbounded, |at| Bound::Excluded((at, usize::MAX)));
        self.held.range((after, Bound::Unbounded)).next().map(|(since, _)| *since)
    }

    /// The other leases of the item besides `id`.
    pub(super) fn other_leases(&self, index: usize, id: LeaseId) -> Vec<LeaseId> {
        match &self.items[index].state {
            ItemState::Held(leases) => {
                leases.iter().map(|lease| lease.id).filter(|other| *other != id).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Replaces the start states of a slot of the iteration that `slot` names, and drops results from the former ones; `None`
    /// for another iteration. No lease computes the slot: its failure was decided.
    pub(super) fn replace(&mut self, slot: RolloutWork) -> Option<Key> {
        let group = self.group;
        let index = slot.slot as usize;
        let item = self.items.get_mut(index)?;
        if iteration(&item.work) != slot.iteration {
            return None;
        }
        item.earlier.clear();
        item.work = Arc::new(Work::Rollout(slot));
        Some(Key { group, index })
    }

    /// The lease ended before its result was complete.
    pub(super) fn release(&mut self, index: usize, id: LeaseId, lease: OpenLease) {
        self.change(index, |item| item.drop_lease(id));
        if lease.owner.trust == Trust::Exact {
            let computed = Computed { actor: lease.owner.actor, lease: id, digests: lease.digests };
            self.items[index].remember(EarlierResult { computed, complete: false });
        }
    }

    /// The lease's result is complete. Other leases of the item have been released.
    pub(super) fn complete(&mut self, index: usize, id: LeaseId, lease: OpenLease) -> Completion {
        self.change(index, |item| item.drop_lease(id));
        let OpenLease { owner, digests, chunks, episode, .. } = lease;
        let computed = Computed { actor: owner.actor, lease: id, digests };
        let item = &mut self.items[index];
        if owner.trust == Trust::Exact && !item.is_confirmed(&computed) {
            if let Some(disagreement) = item.complete_contradiction(&computed) {
                return Completion::Failed(disagreement);
            }
            if item.is_contradicted(&computed) {
                item.remember(EarlierResult { computed, complete: true });
                return Completion::Disputed;
            }
        }
        item.earlier.clear();
        let output = match episode {
            Some(result) => Output::Episode(result),
            None => {
                let Computed { actor, lease, digests } = computed;
                Output::Slot(SlotRollout { slot: index as u32, actor, lease, chunks, digests })
            }
        };
        self.change(index, |item| item.state = ItemState::Complete(output));
        Completion::Accepted
    }

    pub(super) fn is_complete(&self) -> bool {
        self.complete == self.items.len()
    }

    /// The results of all items, in order.
    pub(super) fn take(&mut self) -> Effect {
        let (mut rollouts, mut episodes) = (Vec::new(), Vec::new());
        for item in &mut self.items {
            match std::mem::replace(&mut item.state, ItemState::Taken) {
                ItemState::Complete(Output::Slot(rollout)) => rollouts.push(rollout),
                ItemState::Complete(Output::Episode(result)) => episodes.push(result),
                ItemState::Free | ItemState::Held(_) | ItemState::Taken => {}
            }
        }
        match self.group {
            Group::Slots => Effect::Iteration(rollouts),
            Group::Evaluation(iteration) => {
                Effect::Evaluation(EvaluationOutcome { iteration, episodes })
            }
        }
    }

    pub(super) fn len(&self) -> usize {
        self.items.len()
    }

    /// Items without a result.
    pub(super) fn missing(&self) -> usize {
        self.items.len() - self.complete
    }

    /// Whether an item has no lease.
    pub(super) fn any_free(&self) -> bool {
        !self.free.is_empty()
    }

    pub(super) fn earlier_results(&self) -> usize {
        self.items.iter().map(|item| item.earlier.len()).sum()
    }

    /// Chunks of the complete slots that the trainer has not taken.
    pub(super) fn complete_chunks(&self) -> u64 {
        let chunks = self.items.iter().filter_map(|item| match &item.state {
            ItemState::Complete(Output::Slot(rollout)) => Some(rollout.chunks.len() as u64),
            _ => None,
        });
        chunks.sum()
    }
}

/// The iteration that the work belongs to.
pub(super) fn iteration(work: &Work) -> u64 {
    match work {
        Work::Rollout(slot) => slot.iteration,
        Work::Evaluation(episode) => episode.iteration,
    }
}

/// Environments that the work steps.
pub(super) fn environments(work: &Work) -> usize {
    match work {
        Work::Rollout(slot) => slot.environments.len(),
        Work::Evaluation(_) => 1,
    }
}
