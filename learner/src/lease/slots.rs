//! Who computes what: a state machine without clock, socket or thread. The caller passes the time
//! ([`SlotTable::tick`]) and messages in, and takes [`Effect`]s out.
//!
//! A slot is computed from its first step under one lease. A lease ends when its result is complete, when
//! no message comes for its time to live, when it makes no progress for long, when one of its messages is
//! refused, or when the actor's connection closes; then the slot is free again, from its first step.
//! Only the connection on which the actor registered may send messages for its leases.
//!
//! Results are compared by digest. What an ended lease had sent is kept: a later result that contradicts it is computed
//! once more, and if two complete ones differ, the run must stop. A slot that takes much longer than others gets a
//! backup lease, and a share of the slots is audited ([`SecretSample`]). Episodes of evaluations likewise.
//!
//! An actor whose leases expire gets no work for a while, as one whose messages are refused. While a process waits for
//! work, no other one holds more than its share.

use std::collections::BTreeMap;
use std::time::Duration;

use proto::{
    ActorId, Heartbeat, Incarnation, Lease, LeaseId, LeaseStatus, ProcessId, Reason, Refusal,
    RolloutWork, WeightsName, Work,
};

mod actors;
mod audits;
mod claims;
mod disagreement;
mod failures;
mod figures;
mod item;
mod leases;
mod open;
mod outcome;
mod processes;
mod results;
mod returned;
mod typical;
mod works;

use actors::Actors;
pub use actors::{ConnectionId, Trust};
use audits::Audits;
pub use disagreement::{ComputedPart, Disagreement, Part};
use failures::Failures;
pub use leases::ResultPart;
use leases::{Claim, Finished, OpenLease};
use open::OpenLeases;
pub use outcome::{Counts, Effect, EvaluationOutcome, Incident, Offer, SlotRollout};
pub use results::{Assignment, Preview};
use typical::TypicalTimes;
use works::{Group, Works};

use crate::lease::sample::SecretSample;

/// What holds for a table as long as it exists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlotRules {
    /// This start of the learner.
    pub incarnation: Incarnation,
    /// A lease without a message for this long ends.
    pub ttl: Duration,
    /// Chunks of a slot.
    pub chunks_per_slot: u32,
    /// Steps of a slot.
    pub steps_per_slot: u32,
    /// Steps of the longest episode.
    pub episode_steps: u32,
    /// Which slots and episodes are computed twice.
    pub audit: SecretSample,
    /// Whether actors without a fingerprint, which cannot be audited, get no work.
    pub requires_fingerprint: bool,
}

impl SlotRules {
    /// Actors of less trust get no work.
    fn least_trust(&self) -> Trust {
        if self.requires_fingerprint { Trust::Exact } else { Trust::Foreign }
    }
}

/// Who computes what.
#[derive(Debug)]
pub struct SlotTable {
    rules: SlotRules,
    now: Duration,
    over: bool,
    actors: Actors,
    last_lease: u64,
    open: OpenLeases,
    finished: Finished,
    works: BTreeMap<Group, Works>,
    audits: Audits,
    failures: Failures,
    times: TypicalTimes,
    reissued: u64,
    backups: u64,
    effects: Vec<Effect>,
    incidents: Vec<Incident>,
}

impl SlotTable {
    /// An empty table.
    #[must_use]
    pub fn new(rules: SlotRules) -> Self {
        Self {
            rules,
            now: Duration::ZERO,
            over: false,
            actors: Actors::new(rules.ttl),
            last_lease: 0,
            open: OpenLeases::default(),
            finished: Finished::default(),
            works: BTreeMap::new(),
            audits: Audits::new(rules.audit),
            failures: Failures::new(rules.ttl),
            times: TypicalTimes::new(rules.ttl),
            reissued: 0,
            backups: 0,
            effects: Vec::new(),
            incidents: Vec::new(),
        }
    }

    /// It is `now`, counted from any fixed moment; leases past their deadline end. Earlier times are ignored.
    pub fn tick(&mut self, now: Duration) {
        self.now = self.now.max(now);
        for id in self.open.expired(self.now) {
            self.expire(id);
        }
        let processes = &self.actors.processes;
        let has_no_other_auditor =
            |process| processes.any_stalled() && processes.others_are_stalled(process);
        for audit in self.audits.skip_overdue(self.now, has_no_other_auditor) {
            audit.holder.into_iter().for_each(|id| self.expire(id));
            audit.wait.into_iter().for_each(|wait| self.hand_over(wait.group));
        }
    }

    fn expire(&mut self, id: LeaseId) {
        let Some(lease) = self.open.get(id) else { return };
        let actor = lease.owner.actor;
        self.incidents.push(Incident::Expired(lease.status(id, self.now)));
        let pause = self.actors.expired(lease.owner, lease.begun, self.now);
        self.incidents.extend(pause.map(|pause| Incident::Quarantined { actor, pause }));
        self.abandon(id);
    }

    /// When the next lease ends without a message, the next slot or episode may get a backup lease, or the table changes
    /// otherwise by time alone.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Duration> {
        let next = [
            self.open.first_deadline(),
            self.next_backup(),
            self.audits.first_overdue(),
            self.actors.processes.first_released(self.now),
            self.failures.next_try(self.now),
        ];
        next.into_iter().flatten().min()
    }

    /// What is to be done since the last call, in order.
    pub fn effects(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    /// What went wrong since the last call, in order.
    pub fn incidents(&mut self) -> Vec<Incident> {
        std::mem::take(&mut self.incidents)
    }

    /// Opens an iteration; the slots that were open before are dropped, and their leases end.
    pub fn open_iteration(&mut self, weights: WeightsName, slots: Vec<RolloutWork>) {
        let is_slot = |claim| matches!(claim, Claim::Result(key) if key.group == Group::Slots);
        self.open.end(|lease| is_slot(lease.claim));
        self.failures.forget_slots();
        self.works.insert(Group::Slots, Works::slots(weights, slots));
        self.effects.push(Effect::WorkFreed);
    }

    /// Opens an evaluation beside other open work; its episodes are leased when no slot is free.
    pub fn open_evaluation(&mut self, iteration: u64, weights: WeightsName, episodes: u32) {
        let works = Works::episodes(iteration, weights, episodes);
        self.works.insert(works.group, works);
        self.effects.push(Effect::WorkFreed);
    }

    /// The weights that open work names.
    pub(crate) fn weights_in_use(&self) -> impl Iterator<Item = WeightsName> {
        self.works.values().map(|works| works.weights).chain(self.audits.weights())
    }

    /// The run is over: every later request for work is answered so.
    pub fn finish(&mut self) {
        self.over = true;
        self.open.end(|lease| lease.claim == Claim::Audit);
        self.audits.skip_all();
        self.effects.push(Effect::WorkFreed);
    }

    /// Whether the run is over.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.over
    }

    /// Admits an actor that registered on `connection`. One connection carries 16 at most: past that, the
    /// one that registered first is gone. Actors of one `process` do not audit or back up each other.
    pub fn register(
        &mut self,
        connection: ConnectionId,
        trust: Trust,
        process: Option<ProcessId>,
    ) -> ActorId {
        let gone = self.actors.make_room(connection);
        self.end_leases_of(&gone);
        self.actors.register(connection, trust, process, self.now)
    }

    /// Whether an actor registered on this connection.
    pub(crate) fn is_registered(&self, connection: ConnectionId) -> bool {
        self.actors.has(connection)
    }

    /// The connection closed: its actors are gone, their leases end.
    pub fn disconnect(&mut self, connection: ConnectionId) {
        let gone = self.actors.disconnect(connection);
        self.end_leases_of(&gone);
        if !gone.is_empty() {
            // Work that waited for the process may be free for the others now.
            self.effects.push(Effect::WorkFreed);
        }
    }

    fn end_leases_of(&mut self, gone: &[ActorId]) {
        for actor in gone.iter().copied() {
            let leases = self.open.of(actor).map(|(id, lease)| lease.status(id, self.now));
            let leases = leases.collect::<Vec<_>>();
            leases.iter().for_each(|lost| self.abandon(lost.lease));
            self.incidents.push(Incident::Gone { actor, leases });
        }
    }

    /// Gives `actor` the lowest free slot, else the first free evaluation episode, else an audit, else a backup of the
    /// slowest slot or of an episode of another process.
    ///
    /// # Errors
    /// Refuses actors that did not register on the sender's connection, other incarnations, actors without a fingerprint
    /// if one is required, and more leases than one actor may hold.
    pub fn lease(
        &mut self,
        sender: ConnectionId,
        actor: ActorId,
        incarnation: Incarnation,
    ) -> Result<Offer, Refusal> {
        self.same_incarnation(incarnation)?;
        let owner = self.actors.owner(sender, actor)?;
        self.may_be_audited(owner)?;
        self.actors.processes.note_request(owner.process, self.now);
        let held = self.open.of(actor).count();
        let wait = self.actors.quarantine(owner, held, self.now)?;
        if self.over {
            return Ok(Offer::Done);
        }
        if !wait.is_zero() {
            return Ok(Offer::Quarantined(wait));
        }
        let id = LeaseId(self.last_lease + 1);
        let Some(claimed) = self.claim(id, owner) else {
            self.note_no_work(owner);
            return Ok(Offer::Nothing);
        };
        if self.actors.processes.stop_waiting(owner.process) {
            self.effects.push(Effect::WorkFreed);
        }
        self.last_lease = id.0;
        self.open.insert(id, OpenLease::new(owner, &claimed, self.now, self.rules.ttl));
        let weights = claimed.weights;
        let attempt = claimed.attempt;
        let work = (*claimed.work).clone();
        Ok(Offer::Lease(Lease { id, incarnation, weights, attempt, work }))
    }

    /// Takes in a heartbeat; returns whether the lease is still open.
    ///
    /// # Errors
    /// Refuses actors that did not register on the sender's connection, other incarnations, and more steps than the
    /// work has.
    pub fn heartbeat(&mut self, sender: ConnectionId, beat: &Heartbeat) -> Result<bool, Refusal> {
        self.same_incarnation(beat.incarnation)?;
        self.actors.owner(sender, beat.actor)?;
        let own = |lease: &&OpenLease| lease.owner.actor == beat.actor;
        let Some(lease) = self.open.get(beat.lease).filter(own) else {
            return Ok(false);
        };
        let most = match *lease.work {
            Work::Evaluation(_) => self.rules.episode_steps,
            Work::Rollout(_) => self.rules.steps_per_slot,
        };
        if beat.slot_step > most {
            let detail = format!("{}, the work has {most} steps", beat.slot_step);
            return Err(Refusal::new(Reason::BadValue, "slot_step", detail));
        }
        let now = self.now;
        self.open.change(beat.lease, |lease| lease.beat(beat.slot_step, now));
        Ok(true)
    }

    /// A message from this connection was refused. If it was for a lease of the connection, the lease ends and is returned.
    /// The refusal counts against the lease's actor, or else against all actors of the connection.
    pub fn refuse(&mut self, sender: ConnectionId, lease: Option<LeaseId>) -> Option<LeaseStatus> {
        let own = lease.and_then(|id| {
            let open = self.open.get(id).filter(|open| open.owner.connection == sender)?;
            Some(open.status(id, self.now))
        });
        let actors = own.map_or_else(|| self.actors.of(sender), |ended| vec![ended.actor]);
        for actor in actors {
            if let Some(pause) = self.actors.strike(actor, self.now) {
                self.incidents.push(Incident::Quarantined { actor, pause });
            }
        }
        if let Some(ended) = own {
            self.abandon(ended.lease);
        }
        own
    }

    fn abandon(&mut self, id: LeaseId) {
        let Some(lease) = self.open.remove(id) else { return };
        match lease.claim {
            Claim::Audit => self.audits.release(id),
            Claim::Result(key) => {
                if let Some(works) = self.works.get_mut(&key.group) {
                    works.release(key.index, id, lease);
                }
            }
        }
        self.effects.push(Effect::WorkFreed);
    }

    fn same_incarnation(&self, found: Incarnation) -> Result<(), Refusal> {
        if found == self.rules.incarnation {
            return Ok(());
        }
        let detail = format!("{found}, this start of the learner is {}", self.rules.incarnation);
        Err(Refusal::new(Reason::OtherIncarnation, "incarnation", detail))
    }
}
