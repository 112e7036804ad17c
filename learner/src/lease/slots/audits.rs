//! Audits: a share of the accepted slots is computed again by another actor, and the digests are compared. An audit
//! is leased when no other work is free, and the slot's result is used meanwhile.

use std::collections::VecDeque;

use proto::{Digest, LeaseId, RolloutWork, WeightsName};
use sha2::{Digest as _, Sha256};

use super::actors::Owner;
use super::iteration::{ComputedChunk, Disagreement, first_difference};
use super::leases::OpenLease;

/// Audits that wait for an actor or are computed. When one more comes, the oldest that nobody computes is skipped.
const MOST_OPEN: usize = 8;

/// Which slots are audited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AuditPlan {
    /// Share of the slots, 0 to 1.
    pub share: f64,
    /// Secret of this start of the learner: no actor can tell which slots are audited. No result depends on it.
    pub secret: u64,
}

impl AuditPlan {
    /// No slot is audited.
    pub const NONE: Self = Self { share: 0.0, secret: 0 };

    fn covers(self, iteration: u64, slot: u32) -> bool {
        let mut hash = Sha256::new_with_prefix(self.secret.to_le_bytes());
        hash.update(iteration.to_le_bytes());
        hash.update(slot.to_le_bytes());
        let first = hash.finalize().first_chunk::<8>().copied().unwrap_or_default();
        // Both are exact at 0 and 1.
        (u64::from_le_bytes(first) as f64) < self.share * (u64::MAX as f64)
    }
}

/// Results of all audits so far.
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
    plan: AuditPlan,
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
    pub(super) fn new(plan: AuditPlan) -> Self {
        Self { plan, open: VecDeque::new(), counts: AuditCounts::default() }
    }

    /// The run is over: no open audit will be computed.
    pub(super) fn skip_all(&mut self) {
        self.counts.skipped += self.open.len() as u64;
        self.open.clear();
    }

    /// A slot's result was accepted: it is audited if the plan covers it. Whether it is.
    pub(super) fn consider(
        &mut self,
        work: &RolloutWork,
        weights: WeightsName,
        lease: LeaseId,
        owner: Owner,
        digests: &[Digest],
    ) -> bool {
        if !self.plan.covers(work.iteration, work.slot) {
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

    /// The oldest audit of a slot that came over another connection.
    pub(super) fn claim(&mut self, id: LeaseId, by: Owner) -> Option<(RolloutWork, WeightsName)> {
        let free =
            |audit: &&mut Audit| audit.holder.is_none() && audit.owner.connection != by.connection;
        let audit = self.open.iter_mut().find(free)?;
        audit.holder = Some(id);
        Some((audit.work.clone(), audit.weights))
    }

    pub(super) fn release(&mut self, id: LeaseId) {
        if let Some(audit) = self.open.iter_mut().find(|audit| audit.holder == Some(id)) {
            audit.holder = None;
        }
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
            |actor, lease, digests: &[Digest]| ComputedChunk { actor, lease, digest: digests[at] };
        Some(Disagreement {
            iteration: audit.work.iteration,
            slot: audit.work.slot,
            sequence: at as u32,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_covers_its_share_of_the_slots() {
        let covered = |share| {
            let plan = AuditPlan { share, secret: 7 };
            (0..10_000).filter(|iteration| plan.covers(*iteration, 3)).count()
        };
        assert_eq!((covered(0.0), covered(1.0)), (0, 10_000));
        assert!((70..130).contains(&covered(0.01)), "{}", covered(0.01));
    }
}
