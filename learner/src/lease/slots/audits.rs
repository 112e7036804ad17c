//! Audits: a share of the accepted slots is computed again by another actor, and the digests are compared. An audit
//! is leased when no other work is free, and the slot's result is used meanwhile. Which evaluation episodes are audited is
//! selected here; the evaluation waits for their audits.

use std::collections::VecDeque;

use proto::{Digest, EvaluationWork, LeaseId, RolloutWork, WeightsName};

use super::actors::Owner;
use super::disagreement::{ComputedPart, Disagreement, Part};
use super::iteration::first_difference;
use super::leases::OpenLease;
use crate::sample::SecretSample;

/// Audits that wait for an actor or are computed. When one more comes, the oldest that nobody computes is skipped.
const MOST_OPEN: usize = 8;

/// Added to an episode's number in the sample, so that episodes are selected regardless of the slots.
const EPISODES: u64 = 1 << 32;

/// Results of all audits so far, of slots and of episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AuditCounts {
    /// Both results were equal.
    pub agreed: u64,
    /// The results differed; the run stops at the first.
    pub disagreed: u64,
    /// No other actor had time for it.
    pub skipped: u64,
}

/// The open audits.
#[derive(Debug)]
pub(super) struct Audits {
    sample: SecretSample,
    open: VecDeque<Audit>,
    pub(super) counts: AuditCounts,
}

#[derive(Debug)]
struct Audit {
    work: RolloutWork,
    weights: WeightsName,
    /// Who computed the accepted result, and its digests.
    owner: Owner,
    lease: LeaseId,
    digests: Vec<Digest>,
    holder: Option<LeaseId>,
}

impl Audits {
    pub(super) fn new(sample: SecretSample) -> Self {
        Self { sample, open: VecDeque::new(), counts: AuditCounts::default() }
    }

    /// The run is over: no open audit will be computed.
    pub(super) fn skip_all(&mut self) {
        self.counts.skipped += self.open.len() as u64;
        self.open.clear();
    }

    /// Whether an evaluation episode is audited.
    pub(super) fn covers(&self, work: EvaluationWork) -> bool {
        self.sample.covers([work.iteration, EPISODES + u64::from(work.episode)])
    }

    /// A slot's result was accepted: it is audited if the sample covers it. Whether it is.
    pub(super) fn consider(
        &mut self,
        work: &RolloutWork,
        weights: WeightsName,
        lease: LeaseId,
        owner: Owner,
        digests: &[Digest],
    ) -> bool {
        if !self.sample.covers([work.iteration, work.slot.into()]) {
            return false;
        }
        if self.open.len() == MOST_OPEN {
            let waiting = self.open.iter().position(|audit| audit.holder.is_none());
            self.counts.skipped += 1;
            if waiting.and_then(|at| self.open.remove(at)).is_none() {
                return false;
            }
        }
        let (work, digests) = (work.clone(), digests.to_vec());
        self.open.push_back(Audit { work, weights, owner, lease, digests, holder: None });
        true
    }

    /// The oldest audit of a slot that another process computed.
    pub(super) fn claim(&mut self, id: LeaseId, by: Owner) -> Option<(RolloutWork, WeightsName)> {
        let free = |audit: &&mut Audit| audit.holder.is_none() && !audit.owner.shares_process(&by);
        let audit = self.open.iter_mut().find(free)?;
        audit.holder = Some(id);
        Some((audit.work.clone(), audit.weights))
    }

    pub(super) fn release(&mut self, id: LeaseId) {
        if let Some(audit) = self.open.iter_mut().find(|audit| audit.holder == Some(id)) {
            audit.holder = None;
        }
    }

    /// The audit with this lease could not be computed.
    pub(super) fn skip(&mut self, id: LeaseId) {
        let open = self.open.len();
        self.open.retain(|audit| audit.holder != Some(id));
        self.counts.skipped += (open - self.open.len()) as u64;
    }

    /// The audit's result is complete: a disagreement if it differs from the accepted one.
    pub(super) fn complete(&mut self, id: LeaseId, lease: &OpenLease) -> Option<Disagreement> {
        let at = self.open.iter().position(|audit| audit.holder == Some(id))?;
        let audit = self.open.remove(at)?;
        let Some(at) = first_difference(&audit.digests, &lease.digests) else {
            self.counts.agreed += 1;
            return None;
        };
        self.counts.disagreed += 1;
        let chunk =
            |actor, lease, digests: &[Digest]| ComputedPart { actor, lease, digest: digests[at] };
        Some(Disagreement {
            iteration: audit.work.iteration,
            part: Part::Chunk { slot: audit.work.slot, sequence: at as u32 },
            first: chunk(audit.owner.actor, audit.lease, &audit.digests),
            second: chunk(lease.owner.actor, id, &lease.digests),
        })
    }

    /// The slot that the audit with this lease computes.
    pub(super) fn work(&self, id: LeaseId) -> Option<&RolloutWork> {
        self.open.iter().find(|audit| audit.holder == Some(id)).map(|audit| &audit.work)
    }

    pub(super) fn weights(&self) -> impl Iterator<Item = WeightsName> {
        self.open.iter().map(|audit| audit.weights)
    }

    pub(super) fn open(&self) -> usize {
        self.open.len()
    }
}
