//! Leases: the open ones with the chunks received under them, and the digests of finished ones.

use std::collections::BTreeMap;
use std::time::Duration;

use proto::{
    AckState, Digest, EvaluationWork, LeaseId, LeaseStatus, LeasedWork, Reason, Refusal,
    TrajectoryChunk, WeightsName,
};

use super::actors::Owner;

/// A lease without progress for this many times to live is no longer extended by heartbeats.
const PATIENCE_IN_TTLS: u32 = 6;
/// No lease is extended beyond this many times to live.
const MOST_AGE_IN_TTLS: u32 = 90;
/// Finished leases whose results are recognised when they are sent again after a lost acknowledgement.
const MOST_FINISHED: usize = 4096;

/// What a lease is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Claim {
    /// The slot at this index of the open iteration.
    Slot(usize),
    /// A slot of this or an earlier iteration, computed again to compare the digests.
    Audit {
        /// The slot's number.
        slot: u32,
    },
    /// An evaluation episode.
    Episode(EvaluationWork),
}

/// An open lease.
#[derive(Debug)]
pub(super) struct OpenLease {
    pub(super) owner: Owner,
    pub(super) weights: WeightsName,
    pub(super) claim: Claim,
    pub(super) deadline: Duration,
    pub(super) digests: Vec<Digest>,
    pub(super) chunks: Vec<TrajectoryChunk>,
    pub(super) begun: Duration,
    step: u32,
    progress: Duration,
}

/// State of the lease that a message names.
pub(super) enum LeaseState<'a> {
    /// It is open.
    Open(&'a OpenLease),
    /// Its result is complete and has these digests.
    Finished(&'a [Digest]),
}

impl OpenLease {
    pub(super) fn new(
        owner: Owner,
        weights: WeightsName,
        claim: Claim,
        now: Duration,
        ttl: Duration,
    ) -> Self {
        Self {
            owner,
            weights,
            claim,
            deadline: now + ttl,
            digests: Vec::new(),
            chunks: Vec::new(),
            begun: now,
            step: 0,
            progress: now,
        }
    }

    /// A heartbeat: extends the lease unless it made no progress for long, or is too old. Only accepted chunks are
    /// progress of a slot; an episode has none, so its steps count.
    pub(super) fn beat(&mut self, step: u32, now: Duration, ttl: Duration) {
        if matches!(self.claim, Claim::Episode(_)) && step > self.step {
            self.step = step;
            self.progress = now;
        }
        self.extend(now, ttl);
    }

    fn extend(&mut self, now: Duration, ttl: Duration) {
        let patient = self.progress + ttl * PATIENCE_IN_TTLS;
        let longest = self.begun + ttl * MOST_AGE_IN_TTLS;
        self.deadline = (now + ttl).min(patient).min(longest);
    }

    pub(super) fn status(&self, lease: LeaseId, now: Duration) -> LeaseStatus {
        LeaseStatus {
            lease,
            actor: self.owner.actor,
            work: match self.claim {
                Claim::Slot(index) => LeasedWork::Slot(index as u32),
                Claim::Audit { slot } => LeasedWork::Slot(slot),
                Claim::Episode(work) => LeasedWork::Episode(work.episode),
            },
            chunks: self.digests.len() as u32,
            still_secs: (now - self.progress).as_secs_f64(),
        }
    }

    /// Takes in the next chunk. An audit needs only its digest.
    pub(super) fn accept(
        &mut self,
        digest: Digest,
        chunk: TrajectoryChunk,
        now: Duration,
        ttl: Duration,
    ) {
        self.digests.push(digest);
        if matches!(self.claim, Claim::Slot(_)) {
            self.chunks.push(chunk);
        }
        self.progress = now;
        self.extend(now, ttl);
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
        return repeated(digests, sequence, digest).map(|()| AckState::Repeated);
    }
    if sequence as usize == digests.len() {
        return Ok(AckState::Accepted);
    }
    let detail = format!("{sequence}, the next one of this lease is {}", digests.len());
    Err(Refusal::new(Reason::OutOfOrder, "chunk.sequence", detail))
}

/// Whether chunk `sequence` is equal to the one that was given before.
pub(super) fn repeated(digests: &[Digest], sequence: u32, digest: Digest) -> Result<(), Refusal> {
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

pub(super) fn wrong_kind(found: &str, leased: &str) -> Refusal {
    Refusal::new(Reason::BadValue, "content", format!("{found}, but the lease is for {leased}"))
}
