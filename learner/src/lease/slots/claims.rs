//! Which work an actor gets, and how much a process may hold.

use std::time::Duration;

use proto::{EvaluationWork, LeaseId, Reason, Refusal, RolloutWork, WeightsName, Work};

use super::actors::Owner;
use super::evaluations::ClaimedEpisode;
use super::failures::Key;
use super::iteration::{ClaimedSlot, HeldLease, OpenIteration};
use super::leases::Claim;
use super::{Effect, SlotTable, Trust};

/// The time that a second lease has doubles this many times at most.
const MOST_DOUBLINGS: u32 = 6;

/// What a new lease is for.
pub(super) struct Claimed {
    pub(super) claim: Claim,
    pub(super) weights: WeightsName,
    pub(super) work: Work,
    /// How often the work was leased before.
    pub(super) attempt: u32,
}

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
        if may_audit && let Some(before) = self.now.checked_sub(self.rules.ttl) {
            let audit = self.evaluations.claim_audit(id, owner, before);
            if audit.is_some() {
                return audit.map(Claimed::episode);
            }
        }
        let may_hold_more = self.may_hold_more(owner);
        if may_hold_more && let Some(claimed) = self.claim_free(id, owner) {
            self.reissued += u64::from(claimed.attempt > 0);
            return Some(claimed);
        }
        if may_audit && let Some(claimed) = self.claim_audit(id, owner) {
            return Some(claimed);
        }
        let backup = if may_hold_more { self.claim_backup(id, owner) } else { None };
        self.backups += u64::from(backup.is_some());
        backup
    }

    /// The first free slot, else the first free episode, that the actor's process may try after failures.
    fn claim_free(&mut self, id: LeaseId, owner: Owner) -> Option<Claimed> {
        let (failures, processes) = (&self.failures, &self.actors.processes);
        let (now, least) = ((self.now, self.rules.ttl), self.rules.least_trust());
        let may_try = |key| failures.may_try(key, owner.process, processes.registered(least), now);
        if let Some(open) = &mut self.iteration
            && let Some(slot) = open.claim(id, self.now, |index| may_try(Key::Slot(index)))
        {
            return Some(Claimed::slot(slot, open.weights));
        }
        let may_play = |work: EvaluationWork| may_try(Key::episode(work));
        self.evaluations.claim(id, self.now, may_play).map(Claimed::episode)
    }

    fn claim_audit(&mut self, id: LeaseId, owner: Owner) -> Option<Claimed> {
        if let Some(episode) = self.evaluations.claim_audit(id, owner, self.now) {
            return Some(Claimed::episode(episode));
        }
        self.audits.claim(id, owner).map(|(work, weights)| Claimed::audit(work, weights))
    }

    /// A backup of a slow slot, or of one that only stalled processes hold, else of such an episode. If there is one
    /// already that is slow too and shows nothing, it is replaced.
    fn claim_backup(&mut self, id: LeaseId, owner: Owner) -> Option<Claimed> {
        let (slot_age, episode_age) = (self.backup_age(), self.episode_age());
        let (now, leases, processes) = (self.now, &self.open, &self.actors.processes);
        let holder = |held: &HeldLease| leases.get(held.id).map(|lease| lease.owner);
        let of_another =
            |held: &HeldLease| holder(held).is_some_and(|other| !other.shares_process(&owner));
        let of_stalled = |held: &HeldLease| {
            holder(held).is_some_and(|other| processes.is_stalled(other.process))
        };
        let shows_nothing =
            |held: &HeldLease| leases.get(held.id).is_some_and(|lease| lease.digests.is_empty());
        let (failures, ttl) = (&self.failures, self.rules.ttl);
        let suits = |key: Key, held: &[HeldLease], issued: u32, age: Duration| {
            let (since, patience) = match held {
                [only] => (only.since, age),
                [_, second] if shows_nothing(second) => (second.since, patience(age, issued)),
                _ => return false,
            };
            failures.may_back_up(key, owner.process, (now, ttl))
                && held.iter().all(of_another)
                && (since + patience <= now || held.iter().all(of_stalled))
        };
        let since = if processes.any_stalled() { Some(now) } else { now.checked_sub(slot_age) };
        let slot = since.zip(self.iteration.as_mut()).and_then(|(since, open)| {
            let suits =
                |index, held: &[HeldLease], issued| suits(Key::Slot(index), held, issued, slot_age);
            let (slot, replaced) = open.claim_backup(id, since, now, suits)?;
            Some((Claimed::slot(slot, open.weights), replaced))
        });
        let (claimed, replaced) = slot.or_else(|| {
            let suits = |work: EvaluationWork, held: &[HeldLease], issued| {
                suits(Key::episode(work), held, issued, episode_age)
            };
            let (episode, replaced) = self.evaluations.claim_backup(id, now, suits)?;
            Some((Claimed::episode(episode), replaced))
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
                let missing = |open: &OpenIteration| open.slots() - open.complete_slots();
                let slots = self.iteration.as_ref().map_or(0, missing);
                (slots + self.evaluations.missing()).div_ceil(self.open.holders() + waiting)
            }
        };
        if held >= share && waiting > 0 && self.is_any_free() {
            self.actors.processes.keep_work(self.now);
        }
        held < share
    }

    fn is_any_free(&self) -> bool {
        self.iteration.as_ref().is_some_and(OpenIteration::any_free) || self.evaluations.any_free()
    }

    /// There was nothing for this actor. Its process waits for work if it holds none, unless it may not try the free work
    /// after a failure: nothing is kept for it then.
    pub(super) fn found_nothing(&mut self, owner: Owner) {
        let is_any_free = self.is_any_free();
        let processes = &mut self.actors.processes;
        if is_any_free {
            if processes.wait_no_more(owner.process) {
                self.effects.push(Effect::WorkFreed);
            }
        } else if self.open.held_by(owner.process) == 0 && !processes.is_stalled(owner.process) {
            processes.wait(owner.process, self.now);
        }
    }

    /// A slot that is held for longer than this may get a backup lease.
    pub(super) fn backup_age(&self) -> Duration {
        self.typical.backup_age(self.slot_environments()).unwrap_or(self.rules.ttl)
    }

    /// An episode that is held for longer than this may get a backup lease.
    pub(super) fn episode_age(&self) -> Duration {
        self.typical_episode.backup_age(1).unwrap_or(self.rules.ttl)
    }

    /// When the next slot may get a backup lease.
    pub(super) fn next_backup(&self) -> Option<Duration> {
        let age = self.backup_age();
        let young = |open: &OpenIteration| open.first_held_after(self.now.checked_sub(age));
        self.iteration.as_ref().and_then(young).map(|since| since + age)
    }

    /// When the next episode may get a backup lease.
    pub(super) fn next_episode_backup(&self) -> Option<Duration> {
        let age = self.episode_age();
        let at = self.evaluations.latest_begins().map(|since| since + age);
        at.filter(|at| *at > self.now).min()
    }
}

/// How long a second lease is left alone, after so many leases: twice as long with each further one, so that an actor that
/// needs more than `age` gets its time.
fn patience(age: Duration, issued: u32) -> Duration {
    age * 2_u32.pow(issued.saturating_sub(2).min(MOST_DOUBLINGS))
}

impl Claimed {
    fn slot(slot: ClaimedSlot, weights: WeightsName) -> Self {
        let ClaimedSlot { index, work, attempt } = slot;
        Self { claim: Claim::Slot(index), weights, work: Work::Rollout(work), attempt }
    }

    fn episode((work, weights, attempt): ClaimedEpisode) -> Self {
        Self { claim: Claim::Episode(work), weights, work: Work::Evaluation(work), attempt }
    }

    fn audit(work: RolloutWork, weights: WeightsName) -> Self {
        Self {
            claim: Claim::Audit { slot: work.slot },
            weights,
            work: Work::Rollout(work),
            attempt: 1,
        }
    }
}
