//! Leases: the open ones with what came in under them, and the digests of those that were finished.

use std::collections::BTreeMap;
use std::time::Duration;

use proto::{
    AckState, ActorId, Digest, EvaluationWork, LeaseId, LeaseStatus, LeasedWork, Reason, Refusal,
    TrajectoryChunk, WeightsName,
};

use super::Trust;

/// A lease whose steps stand still for this many times to live is no longer extended by heartbeats.
const PATIENCE_IN_TTLS: u32 = 6;
/// Finished leases whose results are recognised when they come again, because an acknowledgement was lost.
const MOST_FINISHED: usize = 4096;

/// What a lease is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Claim {
    /// The slot at this index of the open iteration.
    Slot(usize),
    /// An evaluation episode.
    Episode(EvaluationWork),
}

/// An open lease.
#[derive(Debug)]
pub(super) struct OpenLease {
    pub(super) actor: ActorId,
    pub(super) trust: Trust,
    pub(super) weights: WeightsName,
    pub(super) claim: Claim,
    pub(super) deadline: Duration,
    pub(super) digests: Vec<Digest>,
    pub(super) chunks: Vec<TrajectoryChunk>,
    step: u32,
    progress: Duration,
}

/// Where a lease stands that a message names.
pub(super) enum Standing<'a> {
    /// It is open.
    Open(&'a OpenLease),
    /// Its result is complete and has these digests.
    Finished(&'a [Digest]),
}

impl OpenLease {
    pub(super) fn new(
        (actor, trust): (ActorId, Trust),
        weights: WeightsName,
        claim: Claim,
        now: Duration,
        ttl: Duration,
    ) -> Self {
        let (digests, chunks, deadline) = (Vec::new(), Vec::new(), now + ttl);
        Self { actor, trust, weights, claim, deadline, digests, chunks, step: 0, progress: now }
    }

    /// Something of the work came in.
    pub(super) fn hear(&mut self, now: Duration, ttl: Duration) {
        self.progress = now;
        self.deadline = now + ttl;
    }

    /// A sign of life: it extends the lease unless the work has stood still for long.
    pub(super) fn beat(&mut self, step: u32, now: Duration, ttl: Duration) {
        if step > self.step {
            self.step = step;
            self.progress = now;
        }
        if now - self.progress < ttl * PATIENCE_IN_TTLS {
            self.deadline = now + ttl;
        }
    }

    pub(super) fn status(&self, lease: LeaseId, now: Duration) -> LeaseStatus {
        LeaseStatus {
            lease,
            actor: self.actor,
            work: match self.claim {
                Claim::Slot(index) => LeasedWork::Slot(index as u32),
                Claim::Episode(work) => LeasedWork::Episode(work.episode),
            },
            chunks: self.chunks.len() as u32,
            still_secs: (now - self.progress).as_secs_f64(),
        }
    }

    pub(super) fn accept(&mut self, digest: Digest, chunk: TrajectoryChunk) {
        self.digests.push(digest);
        self.chunks.push(chunk);
    }

    pub(super) fn same_weights(&self, found: WeightsName) -> Result<(), Refusal> {
        let WeightsName { version, digest } = self.weights;
        let stale = |field, detail| Err(Refusal::new(Reason::StaleWeights, field, detail));
        if found.version != version {
            return stale(
                "weights.version",
                format!("{}, the lease names {version}", found.version),
            );
        }
        if found.digest != digest {
            return stale("weights.digest", format!("{}, the lease names {digest}", found.digest));
        }
        Ok(())
    }
}

/// Digests of finished leases, the latest ones.
#[derive(Debug, Default)]
pub(super) struct Finished(BTreeMap<LeaseId, Vec<Digest>>);

impl Finished {
    pub(super) fn remember(&mut self, id: LeaseId, digests: Vec<Digest>) {
        self.0.insert(id, digests);
        if self.0.len() > MOST_FINISHED {
            self.0.pop_first();
        }
    }

    pub(super) fn count(&self) -> usize {
        self.0.len()
    }

    pub(super) fn digests(&self, id: LeaseId) -> Option<&[Digest]> {
        self.0.get(&id).map(Vec::as_slice)
    }
}

/// How chunk `sequence` of an open lease would be taken in, which has given `digests` so far.
pub(super) fn follows(
    digests: &[Digest],
    sequence: u32,
    digest: Digest,
) -> Result<AckState, Refusal> {
    if (sequence as usize) < digests.len() {
        return repeated(digests, sequence, digest);
    }
    if sequence as usize == digests.len() {
        return Ok(AckState::Accepted);
    }
    let detail = format!("{sequence}, the next one of this lease is {}", digests.len());
    Err(Refusal::new(Reason::OutOfOrder, "chunk.sequence", detail))
}

/// Whether chunk `sequence` is the one that was given before.
pub(super) fn repeated(
    digests: &[Digest],
    sequence: u32,
    digest: Digest,
) -> Result<AckState, Refusal> {
    match digests.get(sequence as usize) {
        Some(held) if *held == digest => Ok(AckState::Repeated),
        Some(held) => {
            let detail = format!("{digest}, this lease gave {held} before");
            Err(Refusal::new(Reason::DigestConflict, "digest", detail))
        }
        None => {
            let detail = format!("{sequence}, the lease is complete with {}", digests.len());
            Err(Refusal::new(Reason::OutOfOrder, "chunk.sequence", detail))
        }
    }
}

pub(super) fn wrong_kind(found: &str, leased: &str) -> Refusal {
    Refusal::new(Reason::BadValue, "content", format!("{found}, but the lease is for {leased}"))
}
