//! Who computes what: a state machine without clock, socket or thread. The caller tells it the time
//! ([`SlotTable::tick`]), hands messages in, and takes [`Effect`]s out.
//!
//! A slot is computed from its first step under one lease. A lease ends when its result is complete, when
//! nothing is heard of it for its time to live, when it stands still for long, when one of its messages
//! is refused, or when the actor's connection closes; then the slot is free again, from its first step.
//! What an ended lease had sent is kept as digests: a later result that contradicts it is computed once
//! more, and if two complete ones differ, the machine or the program is not deterministic and the run
//! must stop.

use std::collections::BTreeMap;
use std::time::Duration;

use proto::{
    Ack, AckState, ActorId, Beat, EvaluationResult, Incarnation, Lease, LeaseId, LeaseStatus,
    PushHeader, Reason, Refusal, RolloutWork, RunState, TrajectoryChunk, WeightsName, Work,
};

mod actors;
mod board;
mod evaluations;
mod leases;
mod outcome;
mod pause;

use actors::{Actors, Admission};
pub use actors::{ConnectionId, Trust};
use board::{Board, Verdict};
pub use board::{Disagreement, Testimony};
use evaluations::Evaluations;
use leases::{Claim, Finished, OpenLease, Standing, follows, repeated, wrong_kind};
pub use outcome::{Counts, Effect, EvaluationOutcome, Footprint, Incident, Offer, SlotRollout};

/// Who computes what.
#[derive(Debug)]
pub struct SlotTable {
    incarnation: Incarnation,
    ttl: Duration,
    chunks_per_slot: u32,
    now: Duration,
    over: bool,
    paused: bool,
    actors: Actors,
    last_lease: u64,
    open: BTreeMap<LeaseId, OpenLease>,
    finished: Finished,
    board: Option<Board>,
    evaluations: Evaluations,
    reissued: u64,
    effects: Vec<Effect>,
    incidents: Vec<Incident>,
}

impl SlotTable {
    /// An empty table. A lease of which nothing is heard for `ttl` ends.
    #[must_use]
    pub fn new(incarnation: Incarnation, ttl: Duration, chunks_per_slot: u32) -> Self {
        Self {
            incarnation,
            ttl,
            chunks_per_slot,
            now: Duration::ZERO,
            over: false,
            paused: false,
            actors: Actors::new(ttl),
            last_lease: 0,
            open: BTreeMap::new(),
            finished: Finished::default(),
            board: None,
            evaluations: Evaluations::default(),
            reissued: 0,
            effects: Vec::new(),
            incidents: Vec::new(),
        }
    }

    /// It is `now`, counted from any fixed moment; leases past their time end. Earlier times are ignored.
    pub fn tick(&mut self, now: Duration) {
        self.now = self.now.max(now);
        let over =
            |(id, lease): (&LeaseId, &OpenLease)| (lease.deadline <= self.now).then_some(*id);
        let expired = self.open.iter().filter_map(over).collect::<Vec<_>>();
        for id in expired {
            let lost = self.open[&id].status(id, self.now);
            self.incidents.push(Incident::Expired(lost));
            self.abandon(id);
        }
    }

    /// When the next lease ends unless something is heard of it.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Duration> {
        self.open.values().map(|lease| lease.deadline).min()
    }

    /// What is to be done since the last call, in order.
    pub fn effects(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    /// What went wrong since the last call, in order.
    pub fn incidents(&mut self) -> Vec<Incident> {
        std::mem::take(&mut self.incidents)
    }

    /// Opens an iteration; whatever was open before is dropped, and its leases end.
    pub fn open_iteration(
        &mut self,
        iteration: u64,
        weights: WeightsName,
        slots: Vec<RolloutWork>,
    ) {
        self.open.retain(|_, lease| matches!(lease.claim, Claim::Episode(_)));
        self.board = Some(Board::new(iteration, weights, slots));
        self.effects.push(Effect::WorkFreed);
    }

    /// Opens an evaluation beside whatever is open; its episodes are leased when no slot is free.
    pub fn open_evaluation(&mut self, iteration: u64, weights: WeightsName, episodes: u32) {
        self.evaluations.open(iteration, weights, episodes);
        self.effects.push(Effect::WorkFreed);
    }

    /// The weights that open work names.
    pub fn weights_in_use(&self) -> impl Iterator<Item = WeightsName> {
        self.board.iter().map(|board| board.weights).chain(self.evaluations.weights())
    }

    /// The run is over: every later request for work is answered so.
    pub fn finish(&mut self) {
        self.over = true;
        self.effects.push(Effect::WorkFreed);
    }

    /// What the run is doing.
    #[must_use]
    pub fn state(&self) -> RunState {
        if self.over { RunState::Done } else { RunState::Running }
    }

    /// How far the table is.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let rolling = self.open.values().filter(|lease| matches!(lease.claim, Claim::Slot(_)));
        let partial = rolling.map(|lease| lease.chunks.len() as u64).sum::<u64>();
        let complete = self.board.as_ref().map_or(0, Board::complete_chunks);
        Counts {
            chunks: partial + complete,
            actors: self.actors.count(),
            foreign: self.actors.foreign,
            reissued: self.reissued,
            leases: self.open.len(),
            slots: self.board.as_ref().map_or(0, Board::slots),
            complete_slots: self.board.as_ref().map_or(0, Board::complete_slots),
        }
    }

    /// The open leases, the oldest first.
    #[must_use]
    pub fn leases(&self) -> Vec<LeaseStatus> {
        self.open.iter().map(|(id, lease)| lease.status(*id, self.now)).collect()
    }

    /// What the table holds in memory.
    #[must_use]
    pub fn footprint(&self) -> Footprint {
        Footprint {
            actors: self.actors.count(),
            open_leases: self.open.len(),
            finished_leases: self.finished.count(),
            chunks: self.counts().chunks,
            witnesses: self.board.as_ref().map_or(0, Board::witnesses),
        }
    }

    /// Admits an actor that spoke on `connection`. One connection carries 16 at most: past that, the
    /// one that registered first is gone.
    pub fn register(&mut self, connection: ConnectionId, trust: Trust) -> ActorId {
        let gone = self.actors.make_room(connection);
        self.end_leases_of(&gone);
        self.actors.register(connection, trust)
    }

    /// The connection closed: its actors are gone, their leases end.
    pub fn disconnect(&mut self, connection: ConnectionId) {
        let gone = self.actors.disconnect(connection);
        self.end_leases_of(&gone);
    }

    fn end_leases_of(&mut self, gone: &[ActorId]) {
        for actor in gone.iter().copied() {
            let leases = self.open.iter().filter(|(_, lease)| lease.actor == actor);
            let leases = leases.map(|(id, lease)| lease.status(*id, self.now)).collect::<Vec<_>>();
            leases.iter().for_each(|lost| self.abandon(lost.lease));
            self.incidents.push(Incident::Gone { actor, leases });
        }
    }

    /// Gives `actor` the lowest free slot, or else the first free evaluation episode.
    ///
    /// # Errors
    /// Refuses unknown actors, other incarnations, and more leases than one actor may hold.
    pub fn lease(&mut self, actor: ActorId, incarnation: Incarnation) -> Result<Offer, Refusal> {
        self.same_incarnation(incarnation)?;
        let held = self.open.values().filter(|lease| lease.actor == actor).count();
        let admission = self.actors.admit(actor, held, self.now)?;
        match admission {
            _ if self.over => return Ok(Offer::Done),
            _ if self.paused => return Ok(Offer::Nothing),
            Admission::Quarantined(wait) => return Ok(Offer::Quarantined(wait)),
            Admission::Welcome => {}
        }
        let owner = (actor, self.actors.trust(actor)?);
        let id = LeaseId(self.last_lease + 1);
        Ok(match self.claim(id) {
            None => Offer::Nothing,
            Some((claim, weights, work, attempt)) => {
                self.last_lease = id.0;
                self.open.insert(id, OpenLease::new(owner, weights, claim, self.now, self.ttl));
                let incarnation = self.incarnation;
                Offer::Lease(Lease { id, incarnation, weights, attempt, work })
            }
        })
    }

    /// What is leased, and how often it was before.
    fn claim(&mut self, id: LeaseId) -> Option<(Claim, WeightsName, Work, u32)> {
        if let Some(board) = &mut self.board
            && let Some((index, work, issued)) = board.claim(id)
        {
            self.reissued += u64::from(issued > 0);
            return Some((Claim::Slot(index), board.weights, Work::Rollout(work), issued));
        }
        let (work, weights, issued) = self.evaluations.claim(id)?;
        self.reissued += u64::from(issued > 0);
        Some((Claim::Episode(work), weights, Work::Evaluation(work), issued))
    }

    /// An actor is alive. Whether its lease still is.
    ///
    /// # Errors
    /// Refuses unknown actors and other incarnations.
    pub fn heartbeat(&mut self, beat: &Beat) -> Result<bool, Refusal> {
        self.same_incarnation(beat.incarnation)?;
        self.actors.known(beat.actor)?;
        let lease = self.open.get_mut(&beat.lease).filter(|lease| lease.actor == beat.actor);
        Ok(lease.map(|lease| lease.beat(beat.slot_step, self.now, self.ttl)).is_some())
    }

    /// Whether chunk `sequence` under `header` would be taken in, before its content is looked at.
    ///
    /// # Errors
    /// Refuses, in this order: another incarnation, a lease that ended or never was, other weights than
    /// the lease's, work of another kind, a chunk that does not follow the last one, and a chunk that
    /// repeats an earlier one with another digest.
    pub fn preview_chunk(&self, header: &PushHeader, sequence: u32) -> Result<AckState, Refusal> {
        match self.standing(header)? {
            Standing::Finished(digests) => repeated(digests, sequence, header.digest),
            Standing::Open(lease) if matches!(lease.claim, Claim::Slot(_)) => {
                follows(&lease.digests, sequence, header.digest)
            }
            Standing::Open(_) => Err(wrong_kind("chunk", "an evaluation")),
        }
    }

    /// Takes in a chunk that has been checked.
    ///
    /// # Errors
    /// What [`Self::preview_chunk`] refuses.
    pub fn chunk(&mut self, header: &PushHeader, chunk: TrajectoryChunk) -> Result<Ack, Refusal> {
        let sequence = chunk.sequence;
        let state = self.preview_chunk(header, sequence)?;
        let ack = |lease_finished| Ack { lease: header.lease, sequence, state, lease_finished };
        let Some(lease) = self.open.get_mut(&header.lease) else {
            return Ok(ack(true));
        };
        lease.hear(self.now, self.ttl);
        if state == AckState::Accepted {
            lease.accept(header.digest, chunk);
        }
        let complete = lease.chunks.len() as u64 == u64::from(self.chunks_per_slot);
        if complete {
            self.complete_slot(header.lease);
        }
        Ok(ack(complete))
    }

    fn complete_slot(&mut self, id: LeaseId) {
        let lease = self.open.remove(&id).expect("the caller holds the open lease");
        let Claim::Slot(index) = lease.claim else {
            unreachable!("only slots have chunks");
        };
        let board = self.board.as_mut().expect("a slot's lease ends with its iteration");
        self.finished.remember(id, lease.digests.clone());
        self.actors.finished(lease.actor);
        match board.complete(index, id, lease) {
            Verdict::Stands => {
                let rollouts = board.take_if_complete();
                self.effects.extend(rollouts.map(Effect::Iteration));
            }
            Verdict::Disputed => self.effects.push(Effect::WorkFreed),
            Verdict::Failed(disagreement) => {
                self.effects.push(Effect::Failed(Box::new(disagreement)))
            }
        }
    }

    /// Takes in the checked result of an evaluation episode.
    ///
    /// # Errors
    /// As [`Self::preview_chunk`], and a result of another episode than the lease's.
    pub fn evaluation(
        &mut self,
        header: &PushHeader,
        result: EvaluationResult,
    ) -> Result<Ack, Refusal> {
        let ack = |state| Ack { lease: header.lease, sequence: 0, state, lease_finished: true };
        let (work, actor) = match self.standing(header)? {
            Standing::Finished(digests) => return repeated(digests, 0, header.digest).map(ack),
            Standing::Open(lease) => match lease.claim {
                Claim::Episode(work) => (work, lease.actor),
                Claim::Slot(_) => return Err(wrong_kind("evaluation", "a slot")),
            },
        };
        if work.episode != result.episode {
            let detail = format!("{}, the lease is for {}", result.episode, work.episode);
            return Err(Refusal::new(Reason::BadValue, "evaluation.episode", detail));
        }
        self.open.remove(&header.lease);
        self.finished.remember(header.lease, vec![header.digest]);
        self.actors.finished(actor);
        let outcome = self.evaluations.complete(work, result);
        self.effects.extend(outcome.map(Effect::Evaluation));
        Ok(ack(AckState::Accepted))
    }

    /// A message of this lease was refused: the lease ends, and the actor's refusals are counted.
    pub fn refuse(&mut self, lease: LeaseId) {
        let Some(open) = self.open.get(&lease) else { return };
        let actor = open.actor;
        if let Some(pause) = self.actors.strike(actor, self.now) {
            self.incidents.push(Incident::Quarantined { actor, pause });
        }
        self.abandon(lease);
    }

    fn abandon(&mut self, id: LeaseId) {
        let Some(lease) = self.open.remove(&id) else {
            return;
        };
        match lease.claim {
            Claim::Episode(work) => self.evaluations.release(work),
            Claim::Slot(index) => {
                let board = self.board.as_mut().expect("a slot's lease ends with its iteration");
                board.release(index, id, lease);
            }
        }
        self.effects.push(Effect::WorkFreed);
    }

    fn standing(&self, header: &PushHeader) -> Result<Standing<'_>, Refusal> {
        self.same_incarnation(header.incarnation)?;
        if let Some(digests) = self.finished.digests(header.lease) {
            return Ok(Standing::Finished(digests));
        }
        let ended = || {
            let detail = format!("lease {} has ended or never was", header.lease);
            Refusal::new(Reason::UnknownLease, "lease_id", detail)
        };
        let lease = self.open.get(&header.lease).ok_or_else(ended)?;
        lease.same_weights(header.weights)?;
        Ok(Standing::Open(lease))
    }

    fn same_incarnation(&self, found: Incarnation) -> Result<(), Refusal> {
        if found == self.incarnation {
            return Ok(());
        }
        let detail = format!("{found}, this start of the learner is {}", self.incarnation);
        Err(Refusal::new(Reason::OtherIncarnation, "incarnation", detail))
    }
}
