//! Leases: what one is for, the parts of the result received under it, and the digests of finished ones.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use proto::{
    Digest, EvaluationResult, LeaseId, LeaseStatus, LeasedWork, Reason, Refusal, TrajectoryChunk,
    WeightsName, Work,
};

use super::actors::Owner;
use super::works::{Key, environments};
use crate::lease::end_states::{Course, follow};

/// A lease without progress for this many times to live is no longer extended by heartbeats.
const PROGRESS_TIMEOUT_IN_TTLS: u32 = 6;
/// No lease is extended beyond this many times to live.
const MOST_AGE_IN_TTLS: u32 = 90;
/// Finished leases whose results are recognised when they are sent again after a lost acknowledgement.
const MOST_FINISHED: usize = 4096;

/// A part of the result of a lease.
#[derive(Clone, Debug, PartialEq)]
pub enum ResultPart {
    /// A chunk of a slot.
    Chunk(TrajectoryChunk),
    /// The whole result of an evaluation episode.
    Episode(EvaluationResult),
}

impl ResultPart {
    /// The place of a chunk in its slot; `None` for an episode.
    #[must_use]
    pub fn sequence(&self) -> Option<u32> {
        match self {
            Self::Chunk(chunk) => Some(chunk.sequence),
            Self::Episode(_) => None,
        }
    }
}

/// What the result of a lease is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Claim {
    /// The result of this slot or episode.
    Result(Key),
    /// The comparison with a result that was accepted, maybe in an earlier iteration.
    Audit,
}

/// What a new lease is for.
#[derive(Debug)]
pub(super) struct Claimed {
    pub(super) claim: Claim,
    pub(super) weights: WeightsName,
    pub(super) work: Arc<Work>,
    /// How often the work was leased before.
    pub(super) attempt: u32,
}

/// An open lease.
#[derive(Debug)]
pub(super) struct OpenLease {
    pub(super) owner: Owner,
    pub(super) weights: WeightsName,
    pub(super) claim: Claim,
    pub(super) work: Arc<Work>,
    pub(super) deadline: Duration,
    pub(super) digests: Vec<Digest>,
    pub(super) chunks: Vec<TrajectoryChunk>,
    pub(super) episode: Option<EvaluationResult>,
    /// What happened to each environment of a slot in the chunks so far.
    pub(super) courses: Vec<Course>,
    pub(super) begun: Duration,
    /// Time to live.
    ttl: Duration,
    step: u32,
    progress: Duration,
}

impl OpenLease {
    pub(super) fn new(owner: Owner, claimed: &Claimed, now: Duration, ttl: Duration) -> Self {
        Self {
            owner,
            weights: claimed.weights,
            claim: claimed.claim,
            work: Arc::clone(&claimed.work),
            deadline: now + ttl,
            digests: Vec::new(),
            chunks: Vec::new(),
            episode: None,
            courses: vec![Course::default(); environments(&claimed.work)],
            begun: now,
            ttl,
            step: 0,
            progress: now,
        }
    }

    /// A heartbeat: extends the lease unless it made no progress for long, or is too old. Only accepted chunks are
    /// progress of a slot; an episode has none, so its steps count.
    pub(super) fn beat(&mut self, step: u32, now: Duration) {
        if matches!(*self.work, Work::Evaluation(_)) && step > self.step {
            self.step = step;
            self.progress = now;
        }
        self.extend(now);
    }

    fn extend(&mut self, now: Duration) {
        let progress_deadline = self.progress + self.ttl * PROGRESS_TIMEOUT_IN_TTLS;
        let longest = self.begun + self.ttl * MOST_AGE_IN_TTLS;
        self.deadline = (now + self.ttl).min(progress_deadline).min(longest);
    }

    pub(super) fn status(&self, lease: LeaseId, now: Duration) -> LeaseStatus {
        LeaseStatus {
            lease,
            actor: self.owner.actor,
            work: match &*self.work {
                Work::Rollout(slot) => LeasedWork::Slot(slot.slot),
                Work::Evaluation(episode) => LeasedWork::Episode(episode.episode),
            },
            chunks: self.digests.len() as u32,
            still_secs: (now - self.progress).as_secs_f64(),
        }
    }

    /// Takes in the next part of the result. An audit needs only its digest.
    pub(super) fn accept(&mut self, digest: Digest, part: ResultPart, now: Duration) {
        self.digests.push(digest);
        if self.claim != Claim::Audit {
            match part {
                ResultPart::Chunk(chunk) => {
                    follow(&mut self.courses, &chunk);
                    self.chunks.push(chunk);
                }
                ResultPart::Episode(result) => self.episode = Some(result),
            }
        }
        self.progress = now;
        self.extend(now);
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
