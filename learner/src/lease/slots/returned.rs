//! Returned leases: the work is tried by another process, begins again with other start states, or ends the run.

use proto::{LeaseFailure, LeaseId, Refusal, ReturnedLease, RolloutWork, Start, TrajectoryChunk};

use super::actors::Owner;
use super::failures::{Begin, Key, Verdict};
use super::leases::Claim;
use super::{ConnectionId, Effect, Incident, SlotTable};
use crate::end_states::SlotCourse;

impl SlotTable {
    /// An actor returns a lease. Nothing happens if the lease has ended.
    ///
    /// # Errors
    /// Refuses actors that did not register on the sender's connection, and other incarnations.
    pub fn give_back(
        &mut self,
        sender: ConnectionId,
        returned: &ReturnedLease,
    ) -> Result<(), Refusal> {
        self.same_incarnation(returned.incarnation)?;
        self.actors.owner(sender, returned.actor)?;
        let (id, failure) = (returned.lease, returned.failure);
        let own = self.open.get(id).filter(|lease| lease.owner.actor == returned.actor);
        let Some(lease) = own.map(|lease| lease.status(id, self.now)) else { return Ok(()) };
        let (detail, environments) = (returned.detail.clone(), self.environments_of(id));
        self.incidents.push(Incident::Returned { lease, failure, detail, environments });
        self.count_failure(id, failure, &returned.detail);
        self.skip_audit(id);
        self.abandon(id);
        self.end_evaluations();
        Ok(())
    }

    /// The results of this lease, if it is of this connection, are refused for numbers that are not finite: its start
    /// states may be the cause. The refusal ends the lease.
    pub(crate) fn diverged(&mut self, sender: ConnectionId, id: LeaseId, detail: &str) {
        let own = self.open.get(id).filter(|lease| lease.owner.connection == sender);
        if own.is_some_and(|lease| self.begin_of(lease.claim) == Begin::Continued) {
            self.count_failure(id, LeaseFailure::Environment, detail);
        }
    }

    /// Counts the failure of the work of a lease that ends now.
    fn count_failure(&mut self, id: LeaseId, failure: LeaseFailure, detail: &str) {
        let Some(lease) = self.open.get(id) else { return };
        let (claim, Owner { actor, process, .. }) = (lease.claim, lease.owner);
        let (begin, status) = (self.begin_of(claim), lease.status(id, self.now));
        let Some(key) = Key::of(claim) else { return };
        if self.is_episode_audit(claim) {
            return;
        }
        if self.is_computed_elsewhere(claim, id) {
            self.failures.note(key, process, self.now);
            return;
        }
        let others = self.actors.processes.registered(self.rules.least_trust());
        let now = (self.now, self.rules.ttl);
        match self.failures.add((key, begin), failure, process, others, now) {
            Verdict::Retry => {}
            Verdict::BeginAgain => self.begin_again(key),
            Verdict::GiveUp(times) => {
                let (work, detail) = (status.work, detail.to_owned());
                self.effects.push(Effect::GivenUp { actor, work, times, detail });
            }
        }
    }

    /// An audit that its actor could not compute is not needed.
    fn skip_audit(&mut self, id: LeaseId) {
        self.audits.skip(id);
        if let Some(Claim::Episode(work)) = self.open.get(id).map(|lease| lease.claim)
            && self.evaluations.skip_audit(work, id)
        {
            self.audits.counts.skipped += 1;
        }
    }

    fn is_episode_audit(&self, claim: Claim) -> bool {
        matches!(claim, Claim::Episode(work) if self.evaluations.is_played(work))
    }

    /// Whether the lease was a backup or has one.
    fn is_computed_elsewhere(&mut self, claim: Claim, id: LeaseId) -> bool {
        let others = match (claim, &self.iteration) {
            (Claim::Slot(index), Some(open)) => open.other_leases(index, id),
            (Claim::Episode(work), _) => self.evaluations.other_leases(work, id),
            _ => Vec::new(),
        };
        !others.is_empty()
    }

    fn begin_again(&mut self, key: Key) {
        let (Key::Slot(index), Some(open)) = (key, &self.iteration) else { return };
        let work = open.work(index).origin();
        self.effects.push(Effect::BeginAgain(work));
    }

    /// Replaces the start states of a slot of the open iteration, which becomes free.
    pub fn replace(&mut self, work: RolloutWork) {
        let Some(open) = &mut self.iteration else { return };
        let index = work.slot as usize;
        if open.iteration != work.iteration || index >= open.slots() {
            return;
        }
        open.replace(index, work);
        self.failures.forget(Key::Slot(index));
        self.effects.push(Effect::WorkFreed);
    }

    /// How the work of a lease starts.
    fn begin_of(&self, claim: Claim) -> Begin {
        let continues = |work: &RolloutWork| {
            let mut starts = work.environments.iter();
            starts.any(|start| matches!(start.start, Start::Continue { .. }))
        };
        if self.slot_of(claim).is_some_and(continues) { Begin::Continued } else { Begin::Fresh }
    }

    /// The slot of the open iteration that a lease computes; `None` for audits and episodes.
    fn slot_of(&self, claim: Claim) -> Option<&RolloutWork> {
        match (claim, &self.iteration) {
            (Claim::Slot(index), Some(open)) => Some(open.work(index)),
            _ => None,
        }
    }

    /// The environments of the slot that a lease computes, unless it is an audit.
    pub(crate) fn environments_of(&self, id: LeaseId) -> Vec<u32> {
        let slot = self.open.get(id).and_then(|lease| self.slot_of(lease.claim));
        slot.map_or_else(Vec::new, |work| work.origin().environments)
    }

    /// The course of the slot that a lease computes, to its last chunk `last`; `None` for audits, whose end states are
    /// compared, and if `last` has no end states.
    pub(crate) fn course(&self, id: LeaseId, last: &TrajectoryChunk) -> Option<SlotCourse> {
        let lease = self.open.get(id)?;
        SlotCourse::new(self.slot_of(lease.claim)?, &lease.chunks, last)
    }
}
