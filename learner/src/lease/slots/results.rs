//! Results of leases: whether a part is taken in, and what happens when a result is complete.

use std::sync::Arc;
use std::time::Duration;

use proto::{Ack, AckState, ActorId, Digest, LeaseId, PushHeader, Reason, Refusal, Work};

use super::actors::Owner;
use super::audits::{Audit, Wait};
use super::disagreement::Computed;
use super::leases::{Claim, OpenLease, ResultPart};
use super::works::{Completion, Group, Key};
use super::{ConnectionId, Effect, SlotTable, Trust};
use crate::lease::end_states::Course;

/// An evaluation waits this many times to live for the audit of an episode, or three times the episode's own time if that is
/// longer. After one, the audit comes before all other work.
const AUDIT_IN_TTLS: u32 = 3;

/// What would happen to a part of a result.
#[derive(Clone, Debug, PartialEq)]
pub enum Preview<T> {
    /// It, or an equal one, was taken in before: its acknowledgement was lost.
    Repeated(Ack),
    /// It is the next one of its lease, and must fit this.
    Next(T),
}

/// What the next part of a lease's result must fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Assignment {
    /// The actor that holds the lease.
    pub actor: ActorId,
    /// Whether its random draws can be checked.
    pub trust: Trust,
    /// The work; the digests of chunks cover its origin.
    pub work: Arc<Work>,
    /// What happened so far to each environment of the slot whose end states count; `None` for an audit, whose end states
    /// are only compared.
    pub courses: Option<Vec<Course>>,
}

impl SlotTable {
    /// Whether a part of a result under `header` would be taken in, before its content is looked at: chunk `sequence` of a
    /// slot, or, with `None`, the result of an episode.
    ///
    /// # Errors
    /// Refuses, in this order: another incarnation, a lease that ended or never was, another connection than the
    /// lease's, other weights than the lease's, work of another kind, a chunk that does not follow the last one, and a
    /// part that repeats an earlier one with another digest.
    pub fn preview(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
        sequence: Option<u32>,
    ) -> Result<Preview<Assignment>, Refusal> {
        let number = sequence.unwrap_or(0);
        let repeated = |lease_finished| {
            let lease = header.lease;
            let state = AckState::Repeated;
            Preview::Repeated(Ack { lease, sequence: number, state, lease_finished })
        };
        self.same_incarnation(header.incarnation)?;
        if let Some(digests) = self.finished.digests(header.lease) {
            return is_repeated(digests, number, header.digest).map(|()| repeated(true));
        }
        let lease = self.lease_for(sender, header)?;
        match (sequence, &*lease.work) {
            (Some(_), Work::Evaluation(_)) => return Err(wrong_kind("chunk", "an evaluation")),
            (None, Work::Rollout(_)) => return Err(wrong_kind("evaluation", "a slot")),
            (Some(_), Work::Rollout(_)) | (None, Work::Evaluation(_)) => {}
        }
        let next = lease.digests.len();
        if (number as usize) < next {
            return is_repeated(&lease.digests, number, header.digest).map(|()| repeated(false));
        }
        if number as usize > next {
            let detail = format!("{number}, the next one of this lease is {next}");
            return Err(Refusal::new(Reason::OutOfOrder, "chunk.sequence", detail));
        }
        Ok(Preview::Next(Assignment {
            actor: lease.owner.actor,
            trust: lease.owner.trust,
            work: Arc::clone(&lease.work),
            courses: (lease.claim != Claim::Audit).then(|| lease.courses.clone()),
        }))
    }

    /// The open lease that `header` names.
    fn lease_for(&self, sender: ConnectionId, header: &PushHeader) -> Result<&OpenLease, Refusal> {
        let id = header.lease;
        let refuse = |reason, detail| Refusal::new(reason, "lease_id", detail);
        let lease = self.open.get(id).ok_or_else(|| {
            refuse(Reason::UnknownLease, format!("lease {id} has ended or never was"))
        })?;
        if lease.owner.connection != sender {
            let detail = format!("lease {id} was given to an actor of another connection");
            return Err(refuse(Reason::OtherConnection, detail));
        }
        lease.same_weights(header.weights)?;
        Ok(lease)
    }

    /// Takes in a part of a result that has been checked.
    ///
    /// # Errors
    /// What [`Self::preview`] refuses.
    pub fn take(
        &mut self,
        sender: ConnectionId,
        header: &PushHeader,
        part: ResultPart,
    ) -> Result<Ack, Refusal> {
        let sequence = part.sequence();
        if let Preview::Repeated(ack) = self.preview(sender, header, sequence)? {
            return Ok(ack);
        }
        let (now, id) = (self.now, header.lease);
        let parts = sequence.map_or(1, |_| self.rules.chunks_per_slot);
        let accept = |lease: &mut OpenLease| {
            lease.accept(header.digest, part, now);
            lease.digests.len() == parts as usize
        };
        let lease_finished = self.open.change(id, accept).unwrap_or(false);
        if lease_finished {
            self.complete(id);
        }
        let sequence = sequence.unwrap_or(0);
        let state = AckState::Accepted;
        Ok(Ack { lease: id, sequence, state, lease_finished })
    }

    fn complete(&mut self, id: LeaseId) {
        let Some(lease) = self.open.remove(id) else { return };
        self.finished.remember(id, lease.digests.clone());
        self.actors.finished(lease.owner);
        match lease.claim {
            Claim::Result(key) => self.complete_work(id, key, lease),
            Claim::Audit => match self.audits.complete(id, lease) {
                Ok(group) => group.into_iter().for_each(|group| self.hand_over(group)),
                Err(disagreement) => self.effects.push(Effect::Failed(Box::new(disagreement))),
            },
        }
    }

    fn complete_work(&mut self, id: LeaseId, key: Key, lease: OpenLease) {
        let Some(works) = self.works.get_mut(&key.group) else { return };
        let slow = self.times.backup_age(works);
        for other in works.other_leases(key.index, id) {
            let Some(slower) = self.open.remove(other) else { continue };
            if slower.digests.is_empty() && self.now - slower.begun >= slow {
                self.actors.processes.lost(slower.owner.process);
            }
            // Its later parts are acknowledged if they are equal, and refused if they are not.
            if slower.owner.trust == Trust::Exact && lease.owner.trust == Trust::Exact {
                self.finished.remember(other, lease.digests.clone());
            }
            works.release(key.index, other, slower);
        }
        let owner = lease.owner;
        let took = self.now.saturating_sub(lease.begun);
        let work = Arc::clone(&lease.work);
        let weights = lease.weights;
        match works.complete(key.index, id, lease) {
            Completion::Accepted => {
                self.failures.forget(key);
                self.actors.counted(owner);
                self.times.add(key.group, took, &work);
                if let Some(accepted) = self.audited(id, owner, key.group, &work) {
                    let wait = self.wait_for_audit(key.group, took);
                    let process = owner.process;
                    let audit = Audit { work, weights, accepted, process, wait, holder: None };
                    if self.audits.open(audit) {
                        self.effects.push(Effect::WorkFreed);
                    }
                }
                self.hand_over(key.group);
            }
            Completion::Disputed => self.effects.push(Effect::WorkFreed),
            Completion::Failed(disagreement) => {
                self.effects.push(Effect::Failed(Box::new(disagreement)));
            }
        }
    }

    /// The accepted result, if it is to be audited: the sample covers it, and another process may soon do so. The audit of
    /// a slot is skipped if there are other processes, but none of them is active.
    fn audited(
        &mut self,
        id: LeaseId,
        owner: Owner,
        group: Group,
        work: &Work,
    ) -> Option<Computed> {
        if owner.trust != Trust::Exact || !self.audits.covers(work) {
            return None;
        }
        let own = owner.process;
        let processes = &self.actors.processes;
        let holds = |process| self.open.held_by(process) > 0;
        if !processes.can_audit_soon(own, self.now, holds) {
            let others = processes.registered(Trust::Exact).any(|process| process != own);
            self.audits.counts.skipped += u64::from(group == Group::Slots && others);
            return None;
        }
        let digests = self.finished.digests(id)?.to_vec();
        Some(Computed { actor: owner.actor, lease: id, digests })
    }

    /// How long the group waits for the audit of work that took so long.
    fn wait_for_audit(&self, group: Group, took: Duration) -> Option<Wait> {
        match group {
            Group::Slots => None,
            Group::Evaluation(_) => {
                let until = self.now + (self.rules.ttl * AUDIT_IN_TTLS).max(took * 3);
                Some(Wait { group, since: self.now, until })
            }
        }
    }

    /// Hands over the results of a group that is complete and waits for no audit.
    pub(super) fn hand_over(&mut self, group: Group) {
        let Some(works) = self.works.get_mut(&group) else { return };
        if !works.is_complete() || self.audits.is_awaited_by(group) {
            return;
        }
        self.effects.push(works.take());
        if group != Group::Slots {
            self.works.remove(&group);
        }
    }
}

/// Whether part `sequence` is equal to the one that was given before.
fn is_repeated(digests: &[Digest], sequence: u32, digest: Digest) -> Result<(), Refusal> {
    match digests.get(sequence as usize) {
        Some(held) if *held == digest => Ok(()),
        Some(held) => {
            let detail = format!("{digest}, the accepted one is {held}");
            Err(Refusal::new(Reason::DigestConflict, "digest", detail))
        }
        None => {
            let detail = format!("{sequence}, the lease is complete with {}", digests.len());
            Err(Refusal::new(Reason::OutOfOrder, "chunk.sequence", detail))
        }
    }
}

fn wrong_kind(found: &str, leased: &str) -> Refusal {
    Refusal::new(Reason::BadValue, "content", format!("{found}, but the lease is for {leased}"))
}
