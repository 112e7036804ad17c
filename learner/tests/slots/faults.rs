//! Each slot of each iteration is consumed exactly once and completely, with any sequence of faults.

use std::collections::BTreeSet;
use std::time::Duration;

use learner::lease::slots::{Effect, Offer, SlotTable};
use proptest::prelude::*;
use proto::{AckState, Heartbeat};

use crate::random_cases::for_all;
use crate::table::{
    Actor, CHUNKS, Held, INCARNATION, TTL, actor, honest, push, table, weights, works,
};

const SLOTS: u32 = 3;

/// An event. Numbers are indices of actors or leases.
#[derive(Clone, Debug)]
enum Event {
    /// An actor joins.
    Register,
    /// An actor requests work.
    Lease(usize),
    /// The next chunk of a lease arrives, or the one `skip` chunks later.
    Push { lease: usize, skip: u32 },
    /// The last chunk of a lease arrives again because its acknowledgement was lost.
    Repeat(usize),
    /// A message for a lease is refused.
    Refuse(usize),
    /// An actor sends a heartbeat.
    Beat(usize),
    /// An actor is killed.
    Disconnect(usize),
    /// Time passes, in tenths of the time to live.
    Pass(u32),
}

fn event() -> impl Strategy<Value = Event> {
    let some = 0..64_usize;
    prop_oneof![
        1 => Just(Event::Register),
        4 => some.clone().prop_map(Event::Lease),
        12 => (some.clone(), prop_oneof![9 => Just(0), 1 => 1..3_u32])
            .prop_map(|(lease, skip)| Event::Push { lease, skip }),
        2 => some.clone().prop_map(Event::Repeat),
        1 => some.clone().prop_map(Event::Refuse),
        2 => some.clone().prop_map(Event::Beat),
        1 => some.prop_map(Event::Disconnect),
        2 => (1..8_u32).prop_map(Event::Pass),
    ]
}

/// The table under test and a model of its actors and trainer.
struct Cluster {
    table: SlotTable,
    now: Duration,
    actors: Vec<Actor>,
    /// All leases and the number of chunks sent for each.
    leases: Vec<(Held, u32)>,
    iteration: u64,
    consumed: BTreeSet<(u64, u32)>,
}

impl Cluster {
    fn new() -> Self {
        let (actors, leases, consumed) = (Vec::new(), Vec::new(), BTreeSet::new());
        Self { table: table(SLOTS), now: Duration::ZERO, actors, leases, iteration: 0, consumed }
    }

    fn apply(&mut self, event: Event) {
        match event {
            Event::Register => self.register(),
            Event::Lease(at) => self.lease(at),
            Event::Push { lease, skip } => self.push(lease, skip),
            Event::Repeat(at) => self.repeat(at),
            Event::Refuse(at) => {
                if let Some((lease, _)) = pick(&self.leases, at) {
                    self.table.refuse(lease.connection, Some(lease.id));
                }
            }
            Event::Beat(at) => self.beat(at),
            Event::Disconnect(at) => {
                if let Some(actor) = pick(&self.actors, at) {
                    self.table.disconnect(actor.connection);
                }
            }
            Event::Pass(tenths) => {
                self.now += TTL * tenths / 10;
                self.table.tick(self.now);
            }
        }
        self.consume();
    }

    fn register(&mut self) {
        // Each actor has a separate connection.
        let connection = self.actors.len() as u64 + 1;
        self.actors.push(actor(&mut self.table, connection));
    }

    fn lease(&mut self, at: usize) {
        let Some(actor) = pick(&self.actors, at) else { return };
        if let Ok(Offer::Lease(lease)) = actor.ask(&mut self.table) {
            self.leases.push((Held { connection: actor.connection, lease }, 0));
        }
    }

    fn push(&mut self, at: usize, skip: u32) {
        let Some(at) = at.checked_rem(self.leases.len()) else { return };
        let (lease, sent) = &mut self.leases[at];
        let sequence = *sent + skip;
        let Some(Ok(ack)) = (sequence < CHUNKS).then(|| push(&mut self.table, lease, sequence))
        else {
            return;
        };
        let accepted = ack.state == AckState::Accepted;
        assert!(!accepted || skip == 0, "a chunk was accepted although an earlier one is missing");
        *sent += 1;
    }

    fn repeat(&mut self, at: usize) {
        let sent = pick(&self.leases, at).filter(|(_, sent)| *sent > 0);
        let Some((lease, sent)) = sent else { return };
        // Refused if the lease has ended. The end of the test checks that no chunk is counted twice.
        let _ = push(&mut self.table, lease, sent - 1);
    }

    fn beat(&mut self, at: usize) {
        let (Some((lease, sent)), Some(actor)) = (pick(&self.leases, at), pick(&self.actors, at))
        else {
            return;
        };
        let (actor, connection) = (actor.id, actor.connection);
        let beat = Heartbeat { actor, incarnation: INCARNATION, lease: lease.id, slot_step: *sent };
        let _ = self.table.heartbeat(connection, &beat);
    }

    /// Takes complete iterations, as the trainer does, and opens the next one.
    fn consume(&mut self) {
        for effect in self.table.effects() {
            match effect {
                Effect::WorkFreed => {}
                Effect::Iteration(rollouts) => {
                    for rollout in rollouts {
                        let lease = self.leases.iter().find(|(lease, _)| lease.id == rollout.lease);
                        let lease = &lease.expect("a rollout comes from a lease").0;
                        let expected = (0..CHUNKS).map(|sequence| honest(lease, sequence));
                        assert_eq!(rollout.digests, expected.collect::<Vec<_>>());
                        let sequences = rollout.chunks.iter().map(|chunk| chunk.sequence);
                        assert!(sequences.eq(0..CHUNKS), "{rollout:?}");
                        let own =
                            |chunk: &proto::TrajectoryChunk| chunk.reward == [lease.id.0 as f32];
                        assert!(
                            rollout.chunks.iter().all(own),
                            "chunks of two leases: {rollout:?}"
                        );
                        assert!(
                            self.consumed.insert((self.iteration, rollout.slot)),
                            "consumed twice"
                        );
                    }
                    self.iteration += 1;
                    self.table.open_iteration(weights(), works(self.iteration, SLOTS));
                }
                other => panic!("unexpected with correct actors: {other:?}"),
            }
        }
    }

    /// Completes the open iteration with one correct actor after all leases have expired.
    fn settle(&mut self) {
        let target = self.iteration + 1;
        self.now += 100 * TTL;
        self.table.tick(self.now);
        self.consume();
        self.register();
        for _ in 0..SLOTS {
            let last = self.actors.len() - 1;
            self.lease(last);
            let lease = self.leases.len() - 1;
            (0..CHUNKS).for_each(|_| self.push(lease, 0));
            self.consume();
        }
        assert_eq!(self.iteration, target, "the open iteration cannot be completed");
    }
}

fn pick<T>(all: &[T], at: usize) -> Option<&T> {
    at.checked_rem(all.len()).map(|at| &all[at])
}

#[test]
fn every_slot_is_consumed_exactly_once_with_any_sequence_of_faults() {
    for_all(256, &proptest::collection::vec(event(), 0..300), |events| {
        let mut cluster = Cluster::new();
        events.into_iter().for_each(|event| cluster.apply(event));
        cluster.settle();
        let expected = (0..cluster.iteration).flat_map(|k| (0..SLOTS).map(move |slot| (k, slot)));
        assert!(cluster.consumed.iter().copied().eq(expected));
    });
}
