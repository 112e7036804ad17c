//! Results of leases: whether they are taken in, and what happens when one is complete.

use proto::{
    Ack, AckState, EvaluationResult, EvaluationWork, LeaseId, PushHeader, Reason, Refusal,
    RolloutOrigin, RolloutWork, TrajectoryChunk,
};

use super::evaluations::{EpisodeAudit, Played, Verdict};
use super::failures::Key;
use super::iteration::Completion;
use super::leases::{Claim, LeaseState, OpenLease, follows, repeated, wrong_kind};
use super::{ConnectionId, Effect, SlotTable, Trust};

/// An evaluation waits this many times to live for the audit of an episode, or three times the episode's own time if that is
/// longer. After one, the audit comes before all other work.
const AUDIT_IN_TTLS: u32 = 3;

/// What would happen to a chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChunkPreview {
    /// It, or an equal one, was taken in before: its acknowledgement was lost.
    Repeated(Ack),
    /// It is the next one of its lease.
    Next {
        /// The slot that the lease is for; its digest covers this.
        origin: RolloutOrigin,
        /// Whether its random draws can be checked.
        trust: Trust,
    },
}

/// What would happen to the result of an evaluation episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EvaluationPreview {
    /// It was taken in before.
    Repeated(Ack),
    /// It is the result of this episode.
    Next(EvaluationWork),
}

impl SlotTable {
    /// Whether chunk `sequence` under `header` would be taken in, before its content is looked at.
    ///
    /// # Errors
    /// Refuses, in this order: another incarnation, a lease that ended or never was, another connection than the
    /// lease's, other weights than the lease's, work of another kind, a chunk that does not follow the last one, and a
    /// chunk that repeats an earlier one with another digest.
    pub fn preview_chunk(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
        sequence: u32,
    ) -> Result<ChunkPreview, Refusal> {
        let repeats = |lease_finished| {
            let (lease, state) = (header.lease, AckState::Repeated);
            ChunkPreview::Repeated(Ack { lease, sequence, state, lease_finished })
        };
        let lease = match self.lease_state(sender, header)? {
            LeaseState::Open(lease) => lease,
            LeaseState::Finished(digests) => {
                return repeated(digests, sequence, header.digest).map(|()| repeats(true));
            }
        };
        let Some(work) = self.rollout_work(header.lease, lease.claim) else {
            return Err(wrong_kind("chunk", "an evaluation"));
        };
        Ok(match follows(&lease.digests, sequence, header.digest)? {
            AckState::Accepted => {
                ChunkPreview::Next { origin: work.origin(), trust: lease.owner.trust }
            }
            AckState::Repeated => repeats(false),
        })
    }

    /// The slot that a lease computes.
    fn rollout_work(&self, id: LeaseId, claim: Claim) -> Option<&RolloutWork> {
        match claim {
            Claim::Slot(index) => self.iteration.as_ref().map(|open| open.work(index)),
            Claim::Audit { .. } => self.audits.work(id),
            Claim::Episode(_) => None,
        }
    }

    /// Takes in a chunk that has been checked.
    ///
    /// # Errors
    /// What [`Self::preview_chunk`] refuses.
    pub fn chunk(
        &mut self,
        sender: ConnectionId,
        header: &PushHeader,
        chunk: TrajectoryChunk,
    ) -> Result<Ack, Refusal> {
        let sequence = chunk.sequence;
        if let ChunkPreview::Repeated(ack) = self.preview_chunk(sender, header, sequence)? {
            return Ok(ack);
        }
        let mut lease_finished = false;
        let (now, ttl, digest) = (self.now, self.rules.ttl, header.digest);
        let accept = |lease: &mut OpenLease| {
            lease.accept(digest, chunk, now, ttl);
            lease.digests.len() as u64
        };
        if let Some(taken) = self.open.change(header.lease, accept) {
            lease_finished = taken == u64::from(self.rules.chunks_per_slot);
        }
        if lease_finished {
            self.complete_rollout(header.lease);
        }
        let (lease, state) = (header.lease, AckState::Accepted);
        Ok(Ack { lease, sequence, state, lease_finished })
    }

    fn complete_rollout(&mut self, id: LeaseId) {
        let Some(lease) = self.open.remove(id) else { return };
        self.finished.remember(id, lease.digests.clone());
        self.actors.finished(lease.owner);
        match lease.claim {
            Claim::Slot(index) => self.complete_slot(id, index, lease),
            Claim::Audit { .. } => {
                let disagreement = self.audits.complete(id, &lease);
                self.effects.extend(disagreement.map(|found| Effect::Failed(Box::new(found))));
            }
            Claim::Episode(_) => {}
        }
    }

    fn complete_slot(&mut self, id: LeaseId, index: usize, lease: OpenLease) {
        let slow = self.backup_age();
        let Some(open) = &mut self.iteration else { return };
        for other in open.other_leases(index, id) {
            if let Some(slower) = self.open.remove(other) {
                if slower.digests.is_empty() && self.now - slower.begun >= slow {
                    self.actors.processes.lost(slower.owner.process);
                }
                // Its later chunks are acknowledged if they are equal, and refused if they are not.
                if slower.owner.trust == Trust::Exact && lease.owner.trust == Trust::Exact {
                    self.finished.remember(other, lease.digests.clone());
                }
                open.release(index, other, slower);
            }
        }
        let (owner, secs) = (lease.owner, self.now.saturating_sub(lease.begun));
        match open.complete(index, id, lease) {
            Completion::Accepted => {
                self.failures.forget(Key::Slot(index));
                self.actors.counted(owner);
                self.typical.add(secs, open.work(index).environments.len());
                let audited = owner.trust == Trust::Exact && self.actors.processes.can_audit();
                let digests = self.finished.digests(id).filter(|_| audited);
                if digests.is_some_and(|digests| {
                    self.audits.consider(open.work(index), open.weights, id, owner, digests)
                }) {
                    self.effects.push(Effect::WorkFreed);
                }
                let rollouts = open.take_if_complete();
                self.effects.extend(rollouts.map(Effect::Iteration));
            }
            Completion::Disputed => self.effects.push(Effect::WorkFreed),
            Completion::Failed(disagreement) => {
                self.effects.push(Effect::Failed(Box::new(disagreement)));
            }
        }
    }

    /// Whether a result of an evaluation episode would be taken in, before its content is looked at.
    ///
    /// # Errors
    /// As [`Self::preview_chunk`].
    pub fn preview_evaluation(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
    ) -> Result<EvaluationPreview, Refusal> {
        match self.lease_state(sender, header)? {
            LeaseState::Finished(digests) => {
                repeated(digests, 0, header.digest)?;
                let (lease, state) = (header.lease, AckState::Repeated);
                let ack = Ack { lease, sequence: 0, state, lease_finished: true };
                Ok(EvaluationPreview::Repeated(ack))
            }
            LeaseState::Open(lease) => match lease.claim {
                Claim::Episode(work) => Ok(EvaluationPreview::Next(work)),
                _ => Err(wrong_kind("evaluation", "a slot")),
            },
        }
    }

    /// Takes in the checked result of an evaluation episode.
    ///
    /// # Errors
    /// As [`Self::preview_chunk`], and a result of another episode than the lease's.
    pub fn evaluation(
        &mut self,
        sender: ConnectionId,
        header: &PushHeader,
        result: EvaluationResult,
    ) -> Result<Ack, Refusal> {
        let work = match self.preview_evaluation(sender, header)? {
            EvaluationPreview::Repeated(ack) => return Ok(ack),
            EvaluationPreview::Next(work) => work,
        };
        if work.episode != result.episode {
            let detail = format!("{}, the lease is for {}", result.episode, work.episode);
            return Err(Refusal::new(Reason::BadValue, "evaluation.episode", detail));
        }
        if let Some(lease) = self.open.remove(header.lease) {
            self.finished.remember(header.lease, vec![header.digest]);
            self.actors.finished(lease.owner);
            self.complete_episode(header, work, &lease, result);
        }
        self.failures.forget(Key::Episode(work.iteration, work.episode));
        let (lease, state) = (header.lease, AckState::Accepted);
        Ok(Ack { lease, sequence: 0, state, lease_finished: true })
    }

    fn complete_episode(
        &mut self,
        header: &PushHeader,
        work: EvaluationWork,
        lease: &OpenLease,
        result: EvaluationResult,
    ) {
        let (id, digest, owner) = (header.lease, header.digest, lease.owner);
        let (now, slow, took) = (self.now, self.episode_age(), self.now - lease.begun);
        for other in self.evaluations.other_leases(work, id) {
            if let Some(slower) = self.open.remove(other) {
                if slower.owner.trust == Trust::Exact && owner.trust == Trust::Exact {
                    self.finished.remember(other, vec![digest]);
                }
                if now - slower.begun >= slow {
                    self.actors.processes.lost(slower.owner.process);
                }
            }
        }
        let open = &self.open;
        let holds = |process| open.held_by(process) > 0;
        let is_audited = owner.trust == Trust::Exact
            && self.audits.covers(work)
            && self.actors.processes.can_audit_soon(owner.process, now, holds);
        let until = now + (self.rules.ttl * AUDIT_IN_TTLS).max(took * 3);
        let audit = is_audited.then_some(EpisodeAudit { since: now, until, holder: None });
        let played = Played { result, digest, owner, lease: id, audit };
        match self.evaluations.complete(work, played) {
            Verdict::First => {
                self.actors.counted(owner);
                self.typical_episode.add(took, 1);
                self.effects.extend(audit.map(|_| Effect::WorkFreed));
            }
            Verdict::Agreed => self.audits.counts.agreed += 1,
            Verdict::Differed(disagreement) => {
                self.audits.counts.disagreed += 1;
                self.effects.push(Effect::Failed(Box::new(disagreement)));
            }
        }
        self.end_evaluations();
    }

    fn lease_state(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
    ) -> Result<LeaseState<'_>, Refusal> {
        self.same_incarnation(header.incarnation)?;
        if let Some(digests) = self.finished.digests(header.lease) {
            return Ok(LeaseState::Finished(digests));
        }
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
        Ok(LeaseState::Open(lease))
    }
}
