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

use std::time::Duration;

use proto::{
    ActorId, Heartbeat, Incarnation, Lease, LeaseId, ProcessId, Reason, Refusal, RolloutWork,
    RunState, WeightsName,
};

mod actors;
mod audits;
mod claims;
mod disagreement;
mod evaluations;
mod failures;
mod figures;
mod iteration;
mod leases;
mod open;
mod outcome;
mod processes;
mod results;
mod returned;
mod typical;

use actors::{Actors, Admission};
pub use actors::{ConnectionId, Trust};
pub use audits::AuditCounts;
use audits::Audits;
use claims::Claimed;
pub use disagreement::{ComputedPart, Disagreement, Part};
use evaluations::Evaluations;
use failures::Failures;
use iteration::OpenIteration;
use leases::{Claim, Finished, OpenLease};
use open::OpenLeases;
pub use outcome::{Counts, Effect, EvaluationOutcome, Footprint, Incident, Offer, SlotRollout};
pub use results::{ChunkPreview, EvaluationPreview};
use typical::TypicalTime;

use crate::sample::SecretSample;

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
    iteration: Option<OpenIteration>,
    evaluations: Evaluations,
    audits: Audits,
    failures: Failures,
    typical: TypicalTime,
    typical_episode: TypicalTime,
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
            iteration: None,
            evaluations: Evaluations::default(),
            audits: Audits::new(rules.audit),
            failures: Failures::default(),
            typical: TypicalTime::default(),
            typical_episode: TypicalTime::default(),
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
        let hopeless = |process| processes.any_stalled() && processes.others_are_stalled(process);
        let skipped = self.evaluations.skip_audits(self.now, hopeless);
        if !skipped.is_empty() {
            self.audits.counts.skipped += skipped.len() as u64;
            skipped.into_iter().flatten().for_each(|id| self.expire(id));
            self.end_evaluations();
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

    /// Hands over the evaluations that no longer wait for a result or an audit.
    fn end_evaluations(&mut self) {
        let complete = self.evaluations.take_complete();
        self.effects.extend(complete.into_iter().map(Effect::Evaluation));
    }

    /// When the next lease ends without a message, the next slot or episode may get a backup lease, or the table changes
    /// otherwise by time alone.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Duration> {
        let others = [
            self.evaluations.first_skipped(),
            self.actors.processes.first_released(self.now),
            self.failures.next_try(self.now, self.rules.ttl),
        ];
        let backups = self.next_backup().into_iter().chain(self.next_episode_backup());
        self.open
            .first_deadline()
            .into_iter()
            .chain(backups)
            .chain(others.into_iter().flatten())
            .min()
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
    pub fn open_iteration(
        &mut self,
        iteration: u64,
        weights: WeightsName,
        slots: Vec<RolloutWork>,
    ) {
        self.open.end(|lease| matches!(lease.claim, Claim::Slot(_)));
        self.failures.forget_slots();
        self.iteration = Some(OpenIteration::new(iteration, weights, slots));
        self.effects.push(Effect::WorkFreed);
    }

    /// Opens an evaluation beside other open work; its episodes are leased when no slot is free.
    pub fn open_evaluation(&mut self, iteration: u64, weights: WeightsName, episodes: u32) {
        self.evaluations.open(iteration, weights, episodes);
        self.effects.push(Effect::WorkFreed);
    }

    /// The weights that open work names.
    pub fn weights_in_use(&self) -> impl Iterator<Item = WeightsName> {
        let rollouts = self.iteration.iter().map(|open| open.weights);
        rollouts.chain(self.evaluations.weights()).chain(self.audits.weights())
    }

    /// The run is over: every later request for work is answered so.
    pub fn finish(&mut self) {
        self.over = true;
        self.open.end(|lease| matches!(lease.claim, Claim::Audit { .. }));
        self.audits.skip_all();
        self.effects.push(Effect::WorkFreed);
    }

    /// What the run is doing.
    #[must_use]
    pub fn state(&self) -> RunState {
        if self.over { RunState::Done } else { RunState::Running }
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
    #[must_use]
    pub fn is_registered(&self, connection: ConnectionId) -> bool {
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
        self.actors.processes.asks(owner.process, self.now);
        let held = self.open.of(actor).count();
        match self.actors.admit(owner, held, self.now)? {
            _ if self.over => return Ok(Offer::Done),
            Admission::Quarantined(wait) => return Ok(Offer::Quarantined(wait)),
            Admission::Welcome => {}
        }
        let id = LeaseId(self.last_lease + 1);
        let Some(Claimed { claim, weights, work, attempt }) = self.claim(id, owner) else {
            self.found_nothing(owner);
            return Ok(Offer::Nothing);
        };
        if self.actors.processes.wait_no_more(owner.process) {
            self.effects.push(Effect::WorkFreed);
        }
        self.last_lease = id.0;
        self.open.insert(id, OpenLease::new(owner, weights, claim, self.now, self.rules.ttl));
        Ok(Offer::Lease(Lease { id, incarnation, weights, attempt, work }))
    }

    /// Environments of a slot of the open iteration.
    fn slot_environments(&self) -> usize {
        self.iteration.as_ref().map_or(0, OpenIteration::slot_environments)
    }

    /// An actor is alive. Whether its lease is still open.
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
        let most = match lease.claim {
            Claim::Episode(_) => self.rules.episode_steps,
            Claim::Slot(_) | Claim::Audit { .. } => self.rules.steps_per_slot,
        };
        if beat.slot_step > most {
            let detail = format!("{}, the work has {most} steps", beat.slot_step);
            return Err(Refusal::new(Reason::BadValue, "slot_step", detail));
        }
        let (now, ttl) = (self.now, self.rules.ttl);
        self.open.change(beat.lease, |lease| lease.beat(beat.slot_step, now, ttl));
        Ok(true)
    }

    /// A message from this connection was refused. If it was for a lease of the connection, the lease ends. The
    /// refusal counts against the lease's actor, or else against all actors of the connection.
    pub fn refuse(&mut self, sender: ConnectionId, lease: Option<LeaseId>) {
        let own = lease.and_then(|id| {
            let open = self.open.get(id).filter(|open| open.owner.connection == sender)?;
            Some((id, open.owner.actor))
        });
        let actors = own.map_or_else(|| self.actors.of(sender), |(_, actor)| vec![actor]);
        for actor in actors {
            if let Some(pause) = self.actors.strike(actor, self.now) {
                self.incidents.push(Incident::Quarantined { actor, pause });
            }
        }
        if let Some((id, _)) = own {
            self.abandon(id);
        }
    }

    fn abandon(&mut self, id: LeaseId) {
        let Some(lease) = self.open.remove(id) else {
            return;
        };
        match lease.claim {
            Claim::Episode(work) => self.evaluations.release(work, id),
            Claim::Audit { .. } => self.audits.release(id),
            Claim::Slot(index) => {
                if let Some(open) = &mut self.iteration {
                    open.release(index, id, lease);
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
