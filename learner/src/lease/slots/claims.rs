//! Which work an actor gets, and how much a process may hold.

use std::time::Duration;

use proto::{LeaseId, Reason, Refusal};

use super::actors::Owner;
use super::item::HeldLease;
use super::leases::Claimed;
use super::works::{Key, Works};
use super::{Effect, SlotTable, Trust};

/// The time that a second lease has doubles this many times at most.
const MOST_DOUBLINGS: u32 = 6;

impl SlotTable {
    /// Refuses an actor whose results no audit can compare, if the run requires that.
    pub(super) fn may_be_audited(&self, owner: Owner) -> Result<(), Refusal> {
        if owner.trust == Trust::Exact || self.rules.least_trust() == Trust::Foreign {
            return Ok(());
        }
        let detail = "the actor gave none, and this learner gives work only to actors that it can audit; start the \
                      learner with audit.fingerprint=optional to admit others";
        Err(Refusal::new(Reason::MissingField, "rollout_fingerprint", detail))
    }

    pub(super) fn claim(&mut self, id: LeaseId, owner: Owner) -> Option<Claimed> {
        let may_audit =
            owner.trust == Trust::Exact && !self.actors.processes.is_stalled(owner.process);
        // An evaluation waits for its audits, so old ones come first.
        if may_audit
            && let Some(latest) = self.now.checked_sub(self.rules.ttl)
            && let Some(audit) = self.audits.claim_late(id, owner, latest)
        {
            return Some(audit);
        }
        let may_hold_more = self.may_hold_more(owner);
        if may_hold_more && let Some(claimed) = self.claim_free(id, owner) {
            self.reissued += u64::from(claimed.attempt > 0);
            return Some(claimed);
        }
        if may_audit && let Some(audit) = self.audits.claim(id, owner) {
            return Some(audit);
        }
        let backup = if may_hold_more { self.claim_backup(id, owner) } else { None };
        self.backups += u64::from(backup.is_some());
        backup
    }

    /// The first free slot, else the first free episode, that the actor's process may try after failures.
    fn claim_free(&mut self, id: LeaseId, owner: Owner) -> Option<Claimed> {
        let failures = &self.failures;
        let processes = &self.actors.processes;
        let now = self.now;
        let least = self.rules.least_trust();
        let may_try = |key| failures.may_try(key, owner.process, processes.registered(least), now);
        self.works.values_mut().find_map(|works| works.claim(id, now, may_try))
    }

    /// A backup of a slow slot, or of one that only stalled processes hold, else of such an episode. If there is one
    /// already that is slow too and shows nothing, it is replaced.
    fn claim_backup(&mut self, id: LeaseId, owner: Owner) -> Option<Claimed> {
        let now = self.now;
        let leases = &self.open;
        let processes = &self.actors.processes;
        let failures = &self.failures;
        let holder = |held: &HeldLease| leases.get(held.id).map(|lease| lease.owner.process);
        let of_another =
            |held: &HeldLease| holder(held).is_some_and(|other| other != owner.process);
        let of_stalled =
            |held: &HeldLease| holder(held).is_some_and(|other| processes.is_stalled(other));
        let shows_nothing =
            |held: &HeldLease| leases.get(held.id).is_some_and(|lease| lease.digests.is_empty());
        let suits = |key: Key, held: &[HeldLease], issued: u32, age: Duration| {
            let (since, timeout) = match held {
                [only] => (only.since, age),
                [_, second] if shows_nothing(second) => {
                    (second.since, second_lease_timeout(age, issued))
                }
                _ => return false,
            };
            failures.may_back_up(key, owner.process, now)
                && held.iter().all(of_another)
                && (since + timeout <= now || held.iter().all(of_stalled))
        };
        let (claimed, replaced) = self.works.values_mut().find_map(|works| {
            let age = self.times.backup_age(works);
            let since = if processes.any_stalled() { now } else { now.checked_sub(age)? };
            works.claim_backup(id, since, now, |key, held, issued| suits(key, held, issued, age))
        })?;
        if let Some(replaced) = replaced.and_then(|replaced| self.open.remove(replaced)) {
            self.actors.processes.lost(replaced.owner.process);
        }
        Some(claimed)
    }

    /// Whether the actor's process may hold one more slot or episode. A stalled process holds one at most. While other
    /// processes wait, it gets none, and the others get no more than their share.
    fn may_hold_more(&mut self, owner: Owner) -> bool {
        let held = self.open.held_by(owner.process);
        let is_stalled = self.actors.processes.is_stalled(owner.process);
        if held == 0 && !is_stalled {
            return true;
        }
        let waiting = self.actors.processes.others_waiting(owner.process, self.now);
        let share = match (waiting, is_stalled) {
            (0, false) => return true,
            (0, true) => 1,
            (_, true) => 0,
            (_, false) => {
                let missing = self.works.values().map(Works::missing).sum::<usize>();
                let missing = missing + self.audits.waits().count();
                missing.div_ceil(self.open.holders() + waiting)
            }
        };
        if held >= share && waiting > 0 && self.is_any_free() {
            self.actors.processes.reserve_free_work(self.now);
        }
        held < share
    }

    fn is_any_free(&self) -> bool {
        self.works.values().any(Works::any_free)
    }

    /// No work is available to this actor. Its process waits for work if it has no lease. If there is free work that the
    /// process may not have, because the work waits or the process failed at it, no work is reserved.
    pub(super) fn note_no_work(&mut self, owner: Owner) {
        let is_any_free = self.is_any_free();
        let processes = &mut self.actors.processes;
        if is_any_free {
            if processes.stop_waiting(owner.process) {
                self.effects.push(Effect::WorkFreed);
            }
        } else if self.open.held_by(owner.process) == 0 && !processes.is_stalled(owner.process) {
            processes.wait(owner.process, self.now);
        }
    }

    /// When the next slot or episode may get a backup lease.
    pub(super) fn next_backup(&self) -> Option<Duration> {
        let next = self.works.values().filter_map(|works| {
            let age = self.times.backup_age(works);
            works.first_held_after(self.now.checked_sub(age)).map(|since| since + age)
        });
        next.min()
    }
}

/// Time before a second lease may be replaced, after `issued` leases; it doubles with each.
fn second_lease_timeout(age: Duration, issued: u32) -> Duration {
    age * 2_u32.pow(issued.saturating_sub(2).min(MOST_DOUBLINGS))
}
