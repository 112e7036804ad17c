//! Audits: a share of the accepted slots and episodes is computed again by another process, and the digests are compared.
//! An audit is leased when no other work is free. The result of a slot is used meanwhile; an evaluation waits for its audits.

use std::sync::Arc;
use std::time::Duration;

use proto::{LeaseId, WeightsName, Work};

use super::actors::{Owner, Process};
use super::disagreement::{Computed, Disagreement};
use super::leases::{Claim, Claimed, OpenLease};
use super::works::Group;
use crate::lease::sample::SecretSample;
use crate::observe::snapshot::AuditCounts;

/// Audits of slots that wait for an actor or are computed. When one more comes, the oldest without a lease is skipped.
const MOST_OPEN: usize = 8;

/// Added to an episode's number in the sample, so that episodes are selected regardless of the slots.
const EPISODES: u64 = 1 << 32;

/// The open audits, the oldest first.
#[derive(Debug)]
pub(super) struct Audits {
    sample: SecretSample,
    open: Vec<Audit>,
    pub(super) counts: AuditCounts,
}

/// Work whose result was accepted and is computed again.
#[derive(Debug)]
pub(super) struct Audit {
    pub(super) work: Arc<Work>,
    pub(super) weights: WeightsName,
    /// The accepted result, and the process that computed it.
    pub(super) accepted: Computed,
    pub(super) process: Process,
    /// The wait of the evaluation of an episode.
    pub(super) wait: Option<Wait>,
    pub(super) holder: Option<LeaseId>,
}

/// How long an evaluation waits for the audit of an episode. The result counts without the audit from `until` on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wait {
    pub(super) group: Group,
    pub(super) since: Duration,
    pub(super) until: Duration,
}

impl Audits {
    pub(super) fn new(sample: SecretSample) -> Self {
        Self { sample, open: Vec::new(), counts: AuditCounts::default() }
    }

    /// Whether the sample covers the work.
    pub(super) fn covers(&self, work: &Work) -> bool {
        self.sample.covers(match work {
            Work::Rollout(slot) => [slot.iteration, slot.slot.into()],
            Work::Evaluation(episode) => [episode.iteration, EPISODES + u64::from(episode.episode)],
        })
    }

    /// Opens an audit. Returns false if the limit of audits of slots is reached and none can be skipped.
    pub(super) fn open(&mut self, audit: Audit) -> bool {
        if audit.wait.is_none() && self.open_slots() == MOST_OPEN {
            let unheld = |audit: &Audit| audit.wait.is_none() && audit.holder.is_none();
            let oldest = self.open.iter().position(unheld);
            self.counts.skipped += 1;
            let Some(oldest) = oldest else { return false };
            self.open.remove(oldest);
        }
        self.open.push(audit);
        true
    }

    /// The oldest audit of what another process computed, those that evaluations wait for first.
    pub(super) fn claim(&mut self, id: LeaseId, by: Owner) -> Option<Claimed> {
        self.claim_of(id, by, |wait| wait.is_some()).or_else(|| self.claim_of(id, by, |_| true))
    }

    /// The oldest audit that an evaluation has waited for since `latest` or before.
    pub(super) fn claim_late(
        &mut self,
        id: LeaseId,
        by: Owner,
        latest: Duration,
    ) -> Option<Claimed> {
        self.claim_of(id, by, |wait| wait.is_some_and(|wait| wait.since <= latest))
    }

    fn claim_of(
        &mut self,
        id: LeaseId,
        by: Owner,
        suits: impl Fn(Option<Wait>) -> bool,
    ) -> Option<Claimed> {
        let free = |audit: &&mut Audit| {
            audit.holder.is_none() && audit.process != by.process && suits(audit.wait)
        };
        let audit = self.open.iter_mut().find(free)?;
        audit.holder = Some(id);
        let weights = audit.weights;
        let work = Arc::clone(&audit.work);
        Some(Claimed { claim: Claim::Audit, weights, work, attempt: 1 })
    }

    /// The lease ended without a result.
    pub(super) fn release(&mut self, id: LeaseId) {
        if let Some(audit) = self.open.iter_mut().find(|audit| audit.holder == Some(id)) {
            audit.holder = None;
        }
    }

    /// The audit's result is complete. A disagreement if it differs from the accepted one, else the group that waited for it.
    pub(super) fn complete(
        &mut self,
        id: LeaseId,
        lease: OpenLease,
    ) -> Result<Option<Group>, Disagreement> {
        let Some(audit) = self.take(id) else { return Ok(None) };
        let computed = Computed { actor: lease.owner.actor, lease: id, digests: lease.digests };
        if let Some(found) = Disagreement::between(&audit.work, &audit.accepted, &computed) {
            self.counts.disagreed += 1;
            return Err(found);
        }
        self.counts.agreed += 1;
        Ok(audit.wait.map(|wait| wait.group))
    }

    /// The audit with this lease could not be computed. The group that waited for it.
    pub(super) fn skip(&mut self, id: LeaseId) -> Option<Group> {
        let audit = self.take(id)?;
        self.counts.skipped += 1;
        audit.wait.map(|wait| wait.group)
    }

    fn take(&mut self, id: LeaseId) -> Option<Audit> {
        let at = self.open.iter().position(|audit| audit.holder == Some(id))?;
        Some(self.open.remove(at))
    }

    /// Ends the audits whose evaluation waits no longer, and those without a lease if `has_no_other_auditor` holds for the process
    /// that played the episode.
    pub(super) fn skip_overdue(
        &mut self,
        now: Duration,
        has_no_other_auditor: impl Fn(Process) -> bool,
    ) -> Vec<Audit> {
        let overdue = |audit: &mut Audit| {
            audit.wait.is_some_and(|wait| {
                wait.until <= now || audit.holder.is_none() && has_no_other_auditor(audit.process)
            })
        };
        let skipped = self.open.extract_if(.., overdue).collect::<Vec<_>>();
        self.counts.skipped += skipped.len() as u64;
        skipped
    }

    /// The run is over: no open audit will be computed.
    pub(super) fn skip_all(&mut self) {
        self.counts.skipped += self.open.len() as u64;
        self.open.clear();
    }

    /// When the first audit is skipped, if no result comes.
    pub(super) fn first_overdue(&self) -> Option<Duration> {
        self.waits().map(|wait| wait.until).min()
    }

    /// Whether a group waits for an audit.
    pub(super) fn is_awaited_by(&self, group: Group) -> bool {
        self.waits().any(|wait| wait.group == group)
    }

    /// Audits that evaluations wait for.
    pub(super) fn waits(&self) -> impl Iterator<Item = Wait> {
        self.open.iter().filter_map(|audit| audit.wait)
    }

    pub(super) fn weights(&self) -> impl Iterator<Item = WeightsName> {
        self.open.iter().map(|audit| audit.weights)
    }

    /// Audits of slots.
    pub(super) fn open_slots(&self) -> usize {
        self.open.iter().filter(|audit| audit.wait.is_none()).count()
    }
}
