//! Returned leases: the work is tried by another process, begins again with other start states, or ends the run.

use proto::{LeaseFailure, LeaseId, Refusal, ReturnedLease, RolloutWork, Start, Work};

use super::failures::{Begin, Verdict};
use super::leases::{Claim, OpenLease};
use super::works::Group;
use super::{ConnectionId, Effect, Incident, SlotTable};

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
        let Some(lease) = own else { return Ok(()) };
        let detail = returned.detail.clone();
        let environments = environments(lease);
        let lease = lease.status(id, self.now);
        self.incidents.push(Incident::Returned { lease, failure, detail, environments });
        self.count_failure(id, failure, &returned.detail);
        let waits = self.audits.skip(id);
        self.abandon(id);
        waits.into_iter().for_each(|group| self.hand_over(group));
        Ok(())
    }

    /// The results of this lease, if it is of this connection, are refused for numbers that are not finite: its start
    /// states may be the cause. The refusal ends the lease.
    pub(crate) fn diverged(&mut self, sender: ConnectionId, id: LeaseId, detail: &str) {
        let own = self.open.get(id).filter(|lease| lease.owner.connection == sender);
        if own.is_some_and(|lease| begin(&lease.work) == Begin::Continued) {
            self.count_failure(id, LeaseFailure::Environment, detail);
        }
    }

    /// Counts the failure of the work of a lease that ends now. The result of an audit is not needed.
    fn count_failure(&mut self, id: LeaseId, failure: LeaseFailure, detail: &str) {
        let Some(lease) = self.open.get(id) else { return };
        let Claim::Result(key) = lease.claim else { return };
        let process = lease.owner.process;
        let works = self.works.get(&key.group);
        if works.is_some_and(|works| !works.other_leases(key.index, id).is_empty()) {
            self.failures.note(key, process, self.now);
            return;
        }
        let others = self.actors.processes.registered(self.rules.least_trust());
        match self.failures.add((key, begin(&lease.work)), failure, process, others, self.now) {
            Verdict::Retry => {}
            Verdict::BeginAgain => {
                if let Work::Rollout(slot) = &*lease.work {
                    self.effects.push(Effect::BeginAgain(slot.origin()));
                }
            }
            Verdict::GiveUp(times) => {
                let status = lease.status(id, self.now);
                let detail = detail.to_owned();
                let (actor, work) = (status.actor, status.work);
                self.effects.push(Effect::GivenUp { actor, work, times, detail });
            }
        }
    }

    /// Replaces the start states of a slot of the open iteration, which becomes free.
    pub fn replace(&mut self, work: RolloutWork) {
        let slots = self.works.get_mut(&Group::Slots);
        if let Some(key) = slots.and_then(|slots| slots.replace(work)) {
            self.failures.forget(key);
            self.effects.push(Effect::WorkFreed);
        }
    }
}

/// How the work starts.
fn begin(work: &Work) -> Begin {
    let continues = |slot: &RolloutWork| {
        let mut starts = slot.environments.iter();
        starts.any(|start| matches!(start.start, Start::Continue { .. }))
    };
    match work {
        Work::Rollout(slot) if continues(slot) => Begin::Continued,
        Work::Rollout(_) | Work::Evaluation(_) => Begin::Fresh,
    }
}

/// The environments of the slot that a lease computes, unless it is an audit.
fn environments(lease: &OpenLease) -> Vec<u32> {
    match (lease.claim, &*lease.work) {
        (Claim::Result(_), Work::Rollout(slot)) => slot.origin().environments,
        _ => Vec::new(),
    }
}
