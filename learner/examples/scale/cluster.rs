//! A learner and its actors in simulated time. The slot table is the learner's own; processors, network and the table's
//! lock are queues.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use learner::sample::SecretSample;
use learner::slots::{ConnectionId, SlotRules, SlotTable};
use proto::{Incarnation, Lease, LeaseId};

use crate::figures::Totals;
use crate::scenario::{Cores, Duplicates, Scenario};
use crate::servers::Servers;

mod actors;
mod service;

use actors::Actor;

const INCARNATION: Incarnation = Incarnation(1);

/// What happens at a moment.
enum Event {
    /// An actor's request for work arrives at the learner.
    Ask(usize),
    /// An actor has lease and weights for its next chunk.
    Step(usize, Lease, u32),
    /// It has computed this chunk.
    Stepped(usize, Lease, u32),
    /// A chunk enters a stage on its way into the table.
    Chunk(Stage, Chunk),
    /// An actor learns that its lease is over.
    Ended(usize, LeaseId),
    /// A heartbeat arrives at the learner.
    Beat(usize, LeaseId),
    /// A deadline of the table has passed.
    Deadline,
    /// The learner has updated the weights.
    Updated,
    /// The machine of an actor fails.
    Fail(usize),
    /// The learner sees that a connection is closed.
    Disconnect(ConnectionId),
    /// An actor is back after a failure.
    Return(usize),
}

/// Where a chunk is.
enum Stage {
    Link,
    Cores,
    Lock,
    Table,
}

struct Chunk {
    actor: usize,
    connection: ConnectionId,
    lease: Lease,
    sequence: u32,
}

/// The learner, its actors, and what will happen.
pub(crate) struct Cluster {
    scenario: Scenario,
    now: Duration,
    agenda: BTreeMap<(Duration, u64), Event>,
    planned: u64,
    deadline: Option<Duration>,
    table: SlotTable,
    iteration: u64,
    opened: Duration,
    /// Slots without a lease, exact if no slot has two.
    free: u64,
    actors: Vec<Actor>,
    connections: u64,
    waiting: VecDeque<usize>,
    incoming: Servers,
    outgoing: Servers,
    cores: Servers,
    lock: Servers,
    totals: Totals,
}

impl Cluster {
    /// A learner that opens its first iteration, and actors that start at the same time.
    pub(crate) fn new(scenario: Scenario) -> Self {
        let share = match scenario.duplicates {
            Duplicates::No => 0.0,
            Duplicates::BackupsAndAudits(share) => share,
        };
        let table = SlotTable::new(SlotRules {
            incarnation: INCARNATION,
            ttl: scenario.lease.ttl,
            chunks_per_slot: scenario.chunks,
            steps_per_slot: scenario.chunks,
            episode_steps: 1,
            audit: SecretSample { share, secret: scenario.seed },
            requires_fingerprint: false,
        });
        let (Cores::Own(cores) | Cores::Shared(cores)) = scenario.cores;
        let mut cluster = Self {
            now: Duration::ZERO,
            agenda: BTreeMap::new(),
            planned: 0,
            deadline: None,
            table,
            iteration: 0,
            opened: Duration::ZERO,
            free: 0,
            actors: Vec::new(),
            connections: 0,
            waiting: VecDeque::new(),
            incoming: Servers::new(1),
            outgoing: Servers::new(1),
            cores: Servers::new(cores),
            lock: Servers::new(1),
            totals: Totals::default(),
            scenario,
        };
        cluster.open();
        (0..cluster.scenario.actors).for_each(|index| cluster.start(index));
        cluster
    }

    /// Simulates this many iterations and counts what happens in them.
    pub(crate) fn run(&mut self, iterations: u64) -> Totals {
        let (begun, before) = (self.now, self.table.counts());
        self.totals = Totals::default();
        while self.totals.iterations < iterations {
            let ((time, _), event) = self.agenda.pop_first().expect("an iteration always ends");
            self.now = time;
            self.happen(event);
        }
        let after = self.table.counts();
        Totals {
            elapsed: self.now - begun,
            reissued: after.reissued - before.reissued,
            backups: after.backups - before.backups,
            ..self.totals
        }
    }

    /// Plans a failure of an actor's machine.
    pub(crate) fn fail_at(&mut self, time: Duration, actor: usize) {
        self.at(time, Event::Fail(actor));
    }

    /// Plans an event.
    fn at(&mut self, time: Duration, event: Event) {
        self.planned += 1;
        self.agenda.insert((time, self.planned), event);
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Ask(actor) if self.actors[actor].asks => {
                self.tick();
                self.settle();
                self.offer(actor);
            }
            Event::Ask(_) => {}
            Event::Step(actor, lease, sequence) => self.step(actor, lease, sequence),
            Event::Stepped(actor, lease, sequence) => self.stepped(actor, lease, sequence),
            Event::Chunk(stage, chunk) => self.advance(&stage, chunk),
            Event::Ended(actor, lease) => self.ended(actor, lease),
            Event::Beat(actor, lease) => self.beat(actor, lease),
            Event::Deadline => {
                self.deadline = None;
                self.tick();
                self.settle();
                self.wake();
            }
            Event::Updated => {
                self.totals.iterations += 1;
                self.iteration += 1;
                self.open();
            }
            Event::Fail(actor) => self.fail(actor),
            Event::Disconnect(connection) => {
                self.tick();
                self.table.disconnect(connection);
                self.settle();
            }
            Event::Return(actor) => self.start(actor),
        }
    }
}
