//! A whole cluster in one thread: a slot table, actors and the network between them, to which events happen. A model of
//! what must hold looks on.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use learner::slots::{ConnectionId, Effect, Offer, SlotRollout, SlotTable, Trust};
use proto::{
    ActorId, EvaluationResult, Heartbeat, Incarnation, Lease, LeaseId, PushHeader, Reason, Refusal,
    Work,
};

use crate::disturbances::{Event, MOST_UNDER_WAY, SEATS};
use crate::table::{CHUNKS, TTL, chunk, half_audited, honest, weights, works};

const SLOTS: u32 = 3;
/// A lease of any start of the learner.
type Key = (Incarnation, LeaseId);

fn key(lease: &Lease) -> Key {
    (lease.incarnation, lease.id)
}

#[derive(Clone, Debug)]
enum Message {
    Ask(ActorId),
    Chunk(Lease, u32),
    Episode(Lease),
    Beat(Heartbeat),
    Offered(Offer),
    Taken { lease: Key, sequence: u32, finished: bool },
    Ended(Key),
    Unknown,
}

/// A message to or from an actor in one of its lives.
#[derive(Clone, Debug)]
struct Letter {
    seat: usize,
    connection: ConnectionId,
    actor: ActorId,
    incarnation: Incarnation,
    message: Message,
}

#[derive(Default)]
struct Seat {
    connection: Option<ConnectionId>,
    actor: Option<(ActorId, Incarnation)>,
    frozen: bool,
    work: Option<Doing>,
}

struct Doing {
    lease: Lease,
    sent: u32,
    acknowledged: u32,
}

pub(crate) struct Cluster {
    table: SlotTable,
    incarnation: Incarnation,
    now: Duration,
    connections: u64,
    seats: Vec<Seat>,
    network: Vec<Letter>,
    iteration: u64,
    /// A complete iteration that the trainer has not taken yet.
    ready: Option<Vec<SlotRollout>>,
    /// The model: what was consumed, and which leases each slot of this start and iteration had.
    consumed: BTreeSet<(u64, u32)>,
    evaluated: BTreeSet<u64>,
    finished: BTreeSet<Key>,
    issued: BTreeMap<(u64, u32), Vec<Lease>>,
}

impl Cluster {
    pub(crate) fn new() -> Self {
        let mut cluster = Self {
            table: SlotTable::new(half_audited(Incarnation(1))),
            incarnation: Incarnation(1),
            now: Duration::ZERO,
            connections: 0,
            seats: (0..SEATS).map(|_| Seat::default()).collect(),
            network: Vec::new(),
            iteration: 0,
            ready: None,
            consumed: BTreeSet::new(),
            evaluated: BTreeSet::new(),
            finished: BTreeSet::new(),
            issued: BTreeMap::new(),
        };
        cluster.open();
        (0..SEATS).for_each(|seat| cluster.join(seat));
        cluster
    }

    pub(crate) fn happen(&mut self, event: Event) {
        match event {
            Event::Act(seat) => self.act(seat),
            Event::Heartbeat(seat) => self.beat(seat),
            Event::Arrive(at) => self.arrive(at),
            Event::ArriveTwice(at) => {
                let again = self.network.get(at).cloned();
                self.arrive(at);
                self.network.extend(again);
            }
            Event::Lose(at) if at < self.network.len() => drop(self.network.remove(at)),
            Event::Lose(_) => {}
            Event::Kill(seat) => self.kill(seat),
            Event::Freeze(seat) => self.seats[seat].frozen = true,
            Event::Thaw(seat) => self.seats[seat].frozen = false,
            Event::Join(seat) => self.join(seat),
            Event::Learn => self.learn(),
            Event::Restart => self.restart(),
            Event::Pass(tenths) => self.now += TTL * tenths / 10,
        }
        self.table.tick(self.now);
        self.take_effects();
        self.network.truncate(MOST_UNDER_WAY);
        self.is_bounded();
    }

    // What actors do.

    fn send(&mut self, seat: usize, message: Message) {
        let own = &self.seats[seat];
        if let (Some((actor, incarnation)), Some(connection)) = (own.actor, own.connection) {
            self.network.push(Letter { seat, connection, actor, incarnation, message });
        }
    }

    fn act(&mut self, seat: usize) {
        let Some((actor, _)) = self.seats[seat].actor.filter(|_| !self.seats[seat].frozen) else {
            return;
        };
        let message = match &mut self.seats[seat].work {
            None => Message::Ask(actor),
            Some(doing) => match doing.lease.work {
                Work::Evaluation(_) => Message::Episode(doing.lease.clone()),
                // Everything is out: what was not acknowledged is sent once more.
                Work::Rollout(_) if doing.sent == CHUNKS => {
                    doing.sent = doing.acknowledged + 1;
                    Message::Chunk(doing.lease.clone(), doing.acknowledged)
                }
                Work::Rollout(_) => {
                    doing.sent += 1;
                    Message::Chunk(doing.lease.clone(), doing.sent - 1)
                }
            },
        };
        self.send(seat, message);
    }

    fn beat(&mut self, seat: usize) {
        let own = &self.seats[seat];
        let (Some((actor, incarnation)), Some(doing), false) = (own.actor, &own.work, own.frozen)
        else {
            return;
        };
        let (lease, slot_step) = (doing.lease.id, doing.sent);
        self.send(seat, Message::Beat(Heartbeat { actor, incarnation, lease, slot_step }));
    }

    fn kill(&mut self, seat: usize) {
        let gone = std::mem::take(&mut self.seats[seat]);
        gone.connection.into_iter().for_each(|connection| self.table.disconnect(connection));
        let left = self.table.leases().into_iter().filter(|lease| {
            // Another start of the learner gives the same numbers to other actors.
            gone.actor == Some((lease.actor, self.incarnation))
        });
        assert_eq!(left.count(), 0, "leases of a closed connection are open");
    }

    fn join(&mut self, seat: usize) {
        if self.seats[seat].actor.is_some() {
            return;
        }
        self.connections += 1;
        let connection = ConnectionId(self.connections);
        let actor = self.table.register(connection, Trust::Exact);
        let actor = Some((actor, self.incarnation));
        self.seats[seat] = Seat { connection: Some(connection), actor, ..Seat::default() };
    }

    fn hear(&mut self, letter: Letter) {
        let Letter { seat, actor, incarnation, message, .. } = letter;
        let own = &mut self.seats[seat];
        // Answers to an earlier life reach nobody.
        if own.actor != Some((actor, incarnation)) {
            return;
        }
        let held = own.work.as_ref().map(|doing| key(&doing.lease));
        match message {
            Message::Offered(Offer::Lease(lease)) if held.is_none() => {
                own.work = Some(Doing { lease, sent: 0, acknowledged: 0 });
            }
            Message::Taken { lease, finished: true, .. } if held == Some(lease) => own.work = None,
            Message::Taken { lease, sequence, .. } if held == Some(lease) => {
                let doing = own.work.as_mut().unwrap();
                doing.acknowledged = doing.acknowledged.max(sequence + 1);
                doing.sent = doing.sent.max(doing.acknowledged);
            }
            Message::Ended(lease) if held == Some(lease) => own.work = None,
            Message::Unknown => self.kill(seat),
            _ => {}
        }
    }

    // What the learner does, as its service would.

    fn arrive(&mut self, at: usize) {
        if at >= self.network.len() {
            return;
        }
        let letter = self.network.remove(at);
        let Letter { seat, connection, actor, incarnation, message } = letter.clone();
        let answer = match message {
            Message::Ask(asking) => self.offer(connection, asking, incarnation),
            Message::Chunk(lease, sequence) => {
                let header = PushHeader::of(&lease, honest(&lease, sequence));
                let taken = self.table.chunk(connection, &header, chunk(&lease, sequence));
                let finished = taken.as_ref().is_ok_and(|ack| ack.lease_finished);
                self.answer(connection, &lease, taken.map(|_| (sequence, finished)))
            }
            Message::Episode(lease) => {
                let Work::Evaluation(work) = lease.work else { unreachable!("sent by act") };
                let episode = work.episode;
                let result = EvaluationResult { episode, extrinsic_return: 1.0, steps: 5 };
                let header = PushHeader::of(&lease, result.digest(work.iteration));
                let taken = self.table.evaluation(connection, &header, result);
                self.answer(connection, &lease, taken.map(|_| (0, true)))
            }
            Message::Beat(beat) => match self.table.heartbeat(connection, &beat) {
                Ok(true) => return,
                Ok(false) => Message::Ended((incarnation, beat.lease)),
                Err(_) => Message::Unknown,
            },
            _ if self.seats[seat].frozen => return self.network.push(letter),
            _ => return self.hear(letter),
        };
        self.network.push(Letter { seat, connection, actor, incarnation, message: answer });
    }

    fn offer(
        &mut self,
        connection: ConnectionId,
        actor: ActorId,
        incarnation: Incarnation,
    ) -> Message {
        match self.table.lease(connection, actor, incarnation) {
            Ok(offer) => {
                assert_eq!(incarnation, self.incarnation, "an offer to an earlier start's actor");
                if let Offer::Lease(lease) = &offer {
                    self.is_rightly_leased(lease);
                }
                Message::Offered(offer)
            }
            Err(refusal) if refusal.reason == Reason::TooManyLeases => {
                Message::Offered(Offer::Nothing)
            }
            Err(_) => Message::Unknown,
        }
    }

    /// An acknowledgement; a refusal ends the lease unless it had ended before.
    fn answer(
        &mut self,
        connection: ConnectionId,
        lease: &Lease,
        taken: Result<(u32, bool), Refusal>,
    ) -> Message {
        self.is_rightly_answered(lease, &taken);
        match taken {
            Ok((sequence, finished)) => Message::Taken { lease: key(lease), sequence, finished },
            Err(refusal) => {
                if !matches!(refusal.reason, Reason::UnknownLease | Reason::OtherIncarnation) {
                    self.table.refuse(connection, Some(lease.id));
                }
                Message::Ended(key(lease))
            }
        }
    }

    fn open(&mut self) {
        self.table.open_iteration(self.iteration, weights(), works(self.iteration, SLOTS));
        // Evaluations come one at a time, as the trainer opens them.
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

    /// A new learner stands where the last one saved: no iteration that was not learnt from is missing.
    fn restart(&mut self) {
        // Another start gives the same numbers to its leases.
        self.issued.clear();
        self.incarnation = Incarnation(self.incarnation.0 + 1);
        self.table = SlotTable::new(half_audited(self.incarnation));
        self.table.tick(self.now);
        self.ready = None;
        self.open();
        if self.evaluated.len() as u64 != self.iteration && self.iteration > 0 {
            let outstanding = self.evaluated.last().map_or(0, |last| last + 1);
            if outstanding < self.iteration {
                self.table.open_evaluation(outstanding, weights(), 1);
            }
        }
    }

    fn take_effects(&mut self) {
        for effect in self.table.effects() {
            match effect {
                Effect::WorkFreed => {}
                Effect::Iteration(rollouts) => {
                    let slots = rollouts.iter().map(|rollout| rollout.slot);
                    assert!(slots.eq(0..SLOTS), "a slot is missing");
                    assert!(self.ready.replace(rollouts).is_none(), "complete twice");
                }
                Effect::Evaluation(outcome) => {
                    assert!(self.evaluated.insert(outcome.iteration), "evaluated twice");
                }
                Effect::Failed(found) => panic!("honest actors never disagree: {found}"),
            }
        }
    }

    // What must hold.

    /// No slot has more than two open leases at a time.
    fn is_rightly_leased(&mut self, lease: &Lease) {
        let Work::Rollout(work) = &lease.work else { return };
        let open = self.table.leases();
        let earlier = self.issued.entry((work.iteration, work.slot)).or_default();
        let is_open = |earlier: &&Lease| open.iter().any(|status| status.lease == earlier.id);
        assert!(earlier.iter().filter(is_open).count() <= 1, "three leases of one slot");
        earlier.push(lease.clone());
    }

    /// Nothing is taken from an earlier start's leases, and what was finished is acknowledged whenever it comes again.
    fn is_rightly_answered(&mut self, lease: &Lease, taken: &Result<(u32, bool), Refusal>) {
        let current = lease.incarnation == self.incarnation;
        assert!(current || taken.is_err(), "taken from an earlier start's lease");
        if current && self.finished.contains(&key(lease)) {
            assert!(
                matches!(taken, Ok((_, true))),
                "a finished lease is not recognised: {taken:?}"
            );
        }
        if let Ok((_, true)) = taken {
            self.finished.insert(key(lease));
        }
    }

    fn is_bounded(&self) {
        let held = self.table.footprint();
        assert!(held.actors <= SEATS, "{held:?}");
        assert!(held.open_leases <= 2 * SLOTS as usize + 1 + 8, "{held:?}");
        assert!(held.chunks <= 2 * u64::from(SLOTS * CHUNKS), "{held:?}");
        assert!(held.open_audits <= 8 && held.earlier_results <= 9 * SLOTS as usize, "{held:?}");
        assert!(held.finished_leases <= 4096, "{held:?}");
    }

    /// The faults are over: actors are back, nothing more is lost, and time goes by. In the end each slot of each
    /// iteration was consumed exactly once.
    pub(crate) fn settle(&mut self) {
        let target = self.iteration + 3;
        (0..SEATS).for_each(|seat| self.happen(Event::Thaw(seat)));
        let mut rounds = 0;
        while self.iteration < target {
            for seat in 0..SEATS {
                self.happen(Event::Join(seat));
                self.happen(Event::Act(seat));
            }
            while !self.network.is_empty() {
                self.happen(Event::Arrive(0));
            }
            self.happen(Event::Learn);
            self.happen(Event::Pass(1));
            rounds += 1;
            assert!(rounds < 500, "the run stands still: {:?}", self.table);
        }
        let expected = (0..self.iteration).flat_map(|k| (0..SLOTS).map(move |slot| (k, slot)));
        assert!(self.consumed.iter().copied().eq(expected));
    }
}
