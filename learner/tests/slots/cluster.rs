//! A simulated cluster in one thread: a slot table, actors and the network between them. A model checks its invariants
//! after every event.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use learner::lease::slots::{
    ConnectionId, Effect, Offer, ResultPart, SlotRollout, SlotTable, Trust,
};
use proto::{
    ActorId, EvaluationResult, Heartbeat, Incarnation, Lease, PushHeader, Reason, Refusal, Work,
};

use crate::events::{
    ACTORS, LeaseKey, MOST_IN_FLIGHT, Message, Packet, SimulatedEvent, key, process_of,
};
use crate::table::{CHUNKS, TTL, chunk, half_audited, honest, weights, works};

const SLOTS: u32 = 3;

#[derive(Default)]
struct ActorState {
    connection: Option<ConnectionId>,
    actor: Option<(ActorId, Incarnation)>,
    frozen: bool,
    work: Option<Progress>,
}

struct Progress {
    lease: Lease,
    sent: u32,
    acknowledged: u32,
}

pub(crate) struct Cluster {
    table: SlotTable,
    incarnation: Incarnation,
    now: Duration,
    connections: u64,
    actors: Vec<ActorState>,
    network: Vec<Packet>,
    iteration: u64,
    /// A complete iteration that the trainer has not taken yet.
    ready: Option<Vec<SlotRollout>>,
    /// The model: consumed slots, and the leases of each slot since the last restart.
    consumed: BTreeSet<(u64, u32)>,
    evaluated: BTreeSet<u64>,
    finished: BTreeSet<LeaseKey>,
    issued: BTreeMap<(u64, u32), Vec<Lease>>,
    /// The actors of this start of the learner, and those whose result of a slot is the accepted one.
    registered: BTreeMap<ActorId, usize>,
    accepted: BTreeMap<(u64, u32), usize>,
}

impl Cluster {
    pub(crate) fn new() -> Self {
        let mut cluster = Self {
            table: SlotTable::new(half_audited(Incarnation(1))),
            incarnation: Incarnation(1),
            now: Duration::ZERO,
            connections: 0,
            actors: (0..ACTORS).map(|_| ActorState::default()).collect(),
            network: Vec::new(),
            iteration: 0,
            ready: None,
            consumed: BTreeSet::new(),
            evaluated: BTreeSet::new(),
            finished: BTreeSet::new(),
            issued: BTreeMap::new(),
            registered: BTreeMap::new(),
            accepted: BTreeMap::new(),
        };
        cluster.open();
        (0..ACTORS).for_each(|index| cluster.join(index));
        cluster
    }

    pub(crate) fn apply(&mut self, event: SimulatedEvent) {
        match event {
            SimulatedEvent::Act(index) => self.act(index),
            SimulatedEvent::Heartbeat(index) => self.beat(index),
            SimulatedEvent::Arrive(at) => self.arrive(at),
            SimulatedEvent::ArriveTwice(at) => {
                let again = self.network.get(at).cloned();
                self.arrive(at);
                self.network.extend(again);
            }
            SimulatedEvent::Lose(at) if at < self.network.len() => drop(self.network.remove(at)),
            SimulatedEvent::Lose(_) => {}
            SimulatedEvent::Refuse(index) => {
                let own = &self.actors[index];
                if let (Some(connection), Some(work)) = (own.connection, &own.work) {
                    self.table.refuse(connection, Some(work.lease.id));
                }
            }
            SimulatedEvent::Kill(index) => self.kill(index),
            SimulatedEvent::Freeze(index) => self.actors[index].frozen = true,
            SimulatedEvent::Thaw(index) => self.actors[index].frozen = false,
            SimulatedEvent::Join(index) => self.join(index),
            SimulatedEvent::Learn => self.learn(),
            SimulatedEvent::Restart => self.restart(),
            SimulatedEvent::Pass(tenths) => self.now += TTL * tenths / 10,
        }
        self.table.tick(self.now);
        self.take_effects();
        self.network.truncate(MOST_IN_FLIGHT);
        self.check_bounds();
    }

    fn send(&mut self, index: usize, message: Message) {
        let own = &self.actors[index];
        if let (Some((actor, incarnation)), Some(connection)) = (own.actor, own.connection) {
            self.network.push(Packet { index, connection, actor, incarnation, message });
        }
    }

    fn act(&mut self, index: usize) {
        let Some((actor, _)) = self.actors[index].actor.filter(|_| !self.actors[index].frozen)
        else {
            return;
        };
        let message = match &mut self.actors[index].work {
            None => Message::Ask(actor),
            Some(progress) => match progress.lease.work {
                Work::Evaluation(_) => Message::Episode(progress.lease.clone()),
                // All chunks are sent: repeat from the first unacknowledged one.
                Work::Rollout(_) if progress.sent == CHUNKS => {
                    progress.sent = progress.acknowledged + 1;
                    Message::Chunk(progress.lease.clone(), progress.acknowledged)
                }
                Work::Rollout(_) => {
                    progress.sent += 1;
                    Message::Chunk(progress.lease.clone(), progress.sent - 1)
                }
            },
        };
        self.send(index, message);
    }

    fn beat(&mut self, index: usize) {
        let own = &self.actors[index];
        let (Some((actor, incarnation)), Some(progress), false) =
            (own.actor, &own.work, own.frozen)
        else {
            return;
        };
        let (lease, slot_step) = (progress.lease.id, progress.sent);
        self.send(index, Message::Beat(Heartbeat { actor, incarnation, lease, slot_step }));
    }

    fn kill(&mut self, index: usize) {
        let killed = std::mem::take(&mut self.actors[index]);
        killed.connection.into_iter().for_each(|connection| self.table.disconnect(connection));
        let left = self.table.leases().into_iter().filter(|lease| {
            // After a restart, the learner assigns the same ids to other actors.
            killed.actor == Some((lease.actor, self.incarnation))
        });
        assert_eq!(left.count(), 0, "leases of a closed connection are open");
    }

    fn join(&mut self, index: usize) {
        if self.actors[index].actor.is_some() {
            return;
        }
        self.connections += 1;
        let connection = ConnectionId(self.connections);
        let actor = self.table.register(connection, Trust::Exact, process_of(index));
        self.registered.insert(actor, index);
        let actor = Some((actor, self.incarnation));
        self.actors[index] =
            ActorState { connection: Some(connection), actor, ..ActorState::default() };
    }

    fn receive(&mut self, packet: Packet) {
        let Packet { index, actor, incarnation, message, .. } = packet;
        let own = &mut self.actors[index];
        // Answers to an earlier process of this actor are dropped.
        if own.actor != Some((actor, incarnation)) {
            return;
        }
        let held = own.work.as_ref().map(|progress| key(&progress.lease));
        match message {
            Message::Offered(Offer::Lease(lease)) if held.is_none() => {
                own.work = Some(Progress { lease, sent: 0, acknowledged: 0 });
            }
            Message::Acknowledged { lease, finished: true, .. } | Message::Ended(lease)
                if held == Some(lease) =>
            {
                own.work = None
            }
            Message::Acknowledged { lease, sequence, .. } if held == Some(lease) => {
                let progress = own.work.as_mut().unwrap();
                progress.acknowledged = progress.acknowledged.max(sequence + 1);
                progress.sent = progress.sent.max(progress.acknowledged);
            }
            Message::Unknown => self.kill(index),
            _ => {}
        }
    }

    // The learner.

    fn arrive(&mut self, at: usize) {
        if at >= self.network.len() {
            return;
        }
        let packet = self.network.remove(at);
        let Packet { index, connection, actor, incarnation, message } = packet.clone();
        let answer = match message {
            Message::Ask(asking) => self.offer(connection, asking, incarnation),
            Message::Chunk(lease, sequence) => {
                let header = PushHeader::of(&lease, honest(&lease, sequence));
                let part = ResultPart::Chunk(chunk(&lease, sequence));
                let accepted = self.table.take(connection, &header, part);
                let accepted = accepted.map(|ack| (sequence, ack.lease_finished));
                self.answer(connection, &lease, accepted)
            }
            Message::Episode(lease) => {
                let Work::Evaluation(work) = lease.work else { unreachable!("sent by act") };
                let (episode, steps) = (work.episode, 5);
                let result = EvaluationResult { episode, steps, ..EvaluationResult::default() };
                let header = PushHeader::of(&lease, result.digest(work.iteration));
                let accepted = self.table.take(connection, &header, ResultPart::Episode(result));
                self.answer(connection, &lease, accepted.map(|_| (0, true)))
            }
            Message::Beat(beat) => match self.table.heartbeat(connection, &beat) {
                Ok(true) => return,
                Ok(false) => Message::Ended((incarnation, beat.lease)),
                Err(_) => Message::Unknown,
            },
            _ if self.actors[index].frozen => return self.network.push(packet),
            _ => return self.receive(packet),
        };
        self.network.push(Packet { index, connection, actor, incarnation, message: answer });
    }

    fn offer(
        &mut self,
        connection: ConnectionId,
        actor: ActorId,
        incarnation: Incarnation,
    ) -> Message {
        match self.table.lease(connection, actor, incarnation) {
            Ok(offer) => {
                assert_eq!(incarnation, self.incarnation, "an offer to an old incarnation");
                if let Offer::Lease(lease) = &offer {
                    self.check_lease(actor, lease);
                }
                Message::Offered(offer)
            }
            Err(refusal) if refusal.reason == Reason::TooManyLeases => {
                Message::Offered(Offer::Nothing)
            }
            Err(_) => Message::Unknown,
        }
    }

    /// The answer to a result. A refusal ends the lease unless it has already ended.
    fn answer(
        &mut self,
        connection: ConnectionId,
        lease: &Lease,
        accepted: Result<(u32, bool), Refusal>,
    ) -> Message {
        self.check_answer(lease, &accepted);
        match accepted {
            Ok((sequence, finished)) => {
                Message::Acknowledged { lease: key(lease), sequence, finished }
            }
            Err(refusal) => {
                if !matches!(refusal.reason, Reason::UnknownLease | Reason::OtherIncarnation) {
                    self.table.refuse(connection, Some(lease.id));
                }
                Message::Ended(key(lease))
            }
        }
    }

    fn open(&mut self) {
        self.table.open_iteration(weights(), works(self.iteration, SLOTS));
        // At most one evaluation is open at a time, as in the trainer.
        if self.evaluated.len() as u64 == self.iteration {
            self.table.open_evaluation(self.iteration, weights(), 1);
        }
    }

    fn learn(&mut self) {
        let Some(rollouts) = self.ready.take() else { return };
        for rollout in rollouts {
            let leases = &self.issued[&(self.iteration, rollout.slot)];
            let lease = leases.iter().find(|lease| lease.id == rollout.lease);
            let lease = lease.expect("a rollout comes from a lease of its slot");
            let digests = (0..CHUNKS).map(|sequence| honest(lease, sequence)).collect::<Vec<_>>();
            let chunks = (0..CHUNKS).map(|sequence| chunk(lease, sequence)).collect::<Vec<_>>();
            assert_eq!((rollout.digests, rollout.chunks), (digests, chunks));
            assert!(self.consumed.insert((self.iteration, rollout.slot)), "consumed twice");
        }
        self.iteration += 1;
        self.open();
    }

    /// Restarts the learner at the open iteration; no finished iteration is lost.
    fn restart(&mut self) {
        // The new table assigns the same lease ids again.
        self.issued.clear();
        self.registered.clear();
        self.accepted.clear();
        self.incarnation = Incarnation(self.incarnation.0 + 1);
        self.table = SlotTable::new(half_audited(self.incarnation));
        self.table.tick(self.now);
        self.ready = None;
        self.open();
        let outstanding = self.evaluated.len() as u64;
        if outstanding < self.iteration {
            self.table.open_evaluation(outstanding, weights(), 1);
        }
    }

    fn take_effects(&mut self) {
        for effect in self.table.effects() {
            match effect {
                Effect::WorkFreed => {}
                Effect::Iteration(rollouts) => {
                    for rollout in &rollouts {
                        let index = self.registered[&rollout.actor];
                        self.accepted.insert((self.iteration, rollout.slot), index);
                    }
                    let slots = rollouts.iter().map(|rollout| rollout.slot);
                    assert!(slots.eq(0..SLOTS), "a slot is missing");
                    assert!(self.ready.replace(rollouts).is_none(), "complete twice");
                }
                Effect::Evaluation(outcome) => {
                    assert!(self.evaluated.insert(outcome.iteration), "evaluated twice");
                }
                other => panic!("correct actors do not cause {other:?}"),
            }
        }
    }

    // The invariants.

    /// A slot has at most two open leases at a time. A slot of a complete iteration is only audited, by another process.
    fn check_lease(&mut self, actor: ActorId, lease: &Lease) {
        let Work::Rollout(work) = &lease.work else { return };
        if let Some(first) = self.accepted.get(&(work.iteration, work.slot)) {
            let (first, second) = (process_of(*first), process_of(self.registered[&actor]));
            assert!(first.is_none() || first != second, "a process audits its own slot");
        }
        let open = self.table.leases();
        let earlier = self.issued.entry((work.iteration, work.slot)).or_default();
        let is_open = |earlier: &&Lease| open.iter().any(|status| status.lease == earlier.id);
        assert!(earlier.iter().filter(is_open).count() <= 1, "three leases of one slot");
        earlier.push(lease.clone());
    }

    /// Results for leases of an earlier incarnation are refused; repeated results for finished leases are acknowledged.
    fn check_answer(&mut self, lease: &Lease, accepted: &Result<(u32, bool), Refusal>) {
        let current = lease.incarnation == self.incarnation;
        assert!(current || accepted.is_err(), "accepted for a lease of an earlier incarnation");
        if current && self.finished.contains(&key(lease)) {
            assert!(matches!(accepted, Ok((_, true))), "not acknowledged: {accepted:?}");
        }
        if let Ok((_, true)) = accepted {
            self.finished.insert(key(lease));
        }
    }

    fn check_bounds(&self) {
        let held = self.table.counts();
        assert!(held.actors <= ACTORS, "{held:?}");
        assert!(held.leases <= 2 * SLOTS as usize + 2 + 8, "{held:?}");
        assert!(held.held_chunks <= 2 * u64::from(SLOTS * CHUNKS), "{held:?}");
        assert!(held.open_audits <= 8 && held.earlier_results <= 8 * SLOTS as usize, "{held:?}");
        assert!(held.finished_leases <= 4096, "{held:?}");
    }

    /// Runs without faults until three more iterations are finished, then checks that each slot of each iteration was
    /// consumed exactly once.
    pub(crate) fn settle(&mut self) {
        let target = self.iteration + 3;
        (0..ACTORS).for_each(|index| self.apply(SimulatedEvent::Thaw(index)));
        let mut rounds = 0;
        while self.iteration < target {
            for index in 0..ACTORS {
                self.apply(SimulatedEvent::Join(index));
                self.apply(SimulatedEvent::Act(index));
            }
            while !self.network.is_empty() {
                self.apply(SimulatedEvent::Arrive(0));
            }
            self.apply(SimulatedEvent::Learn);
            self.apply(SimulatedEvent::Pass(1));
            rounds += 1;
            assert!(rounds < 500, "the run makes no progress: {:?}", self.table);
        }
        let expected = (0..self.iteration).flat_map(|k| (0..SLOTS).map(move |slot| (k, slot)));
        assert!(self.consumed.iter().copied().eq(expected));
    }
}
