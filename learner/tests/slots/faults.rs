//! Whatever is lost, repeated, late or killed: each slot of each iteration is consumed exactly once, and
//! whole.

use std::collections::BTreeSet;
use std::time::Duration;

use learner::slots::{Effect, Offer, SlotTable};
use proptest::prelude::*;
use proto::{AckState, Heartbeat};

use crate::schedules::for_all;
use crate::table::{
    Actor, CHUNKS, Held, INCARNATION, TTL, actor, honest, push, table, weights, works,
};

const SLOTS: u32 = 3;

/// One thing that happens. Numbers choose among whatever there is.
#[derive(Clone, Debug)]
enum Happening {
    /// An actor joins.
    Register,
    /// An actor asks for work.
    Lease(usize),
    /// The next chunk of a lease comes in, or one that is `skip` further on.
    Push { lease: usize, skip: u32 },
    /// The last chunk of a lease comes in again: its acknowledgement was lost.
    Repeat(usize),
    /// Something of a lease was refused.
    Refuse(usize),
    /// An actor gives a sign of life.
    Beat(usize),
    /// An actor is killed.
    Disconnect(usize),
    /// Time passes, in tenths of the time to live.
    Pass(u32),
}

fn happening() -> impl Strategy<Value = Happening> {
    let some = 0..64_usize;
    prop_oneof![
        1 => Just(Happening::Register),
        4 => some.clone().prop_map(Happening::Lease),
        12 => (some.clone(), prop_oneof![9 => Just(0), 1 => 1..3_u32])
            .prop_map(|(lease, skip)| Happening::Push { lease, skip }),
        2 => some.clone().prop_map(Happening::Repeat),
        1 => some.clone().prop_map(Happening::Refuse),
        2 => some.clone().prop_map(Happening::Beat),
        1 => some.prop_map(Happening::Disconnect),
        2 => (1..8_u32).prop_map(Happening::Pass),
    ]
}

/// The table under test, and what the world around it knows.
struct World {
    table: SlotTable,
    now: Duration,
    actors: Vec<Actor>,
    /// Every lease ever given, and the chunks its actor has sent.
    leases: Vec<(Held, u32)>,
    iteration: u64,
    consumed: BTreeSet<(u64, u32)>,
}

impl World {
    fn new() -> Self {
        let (actors, leases, consumed) = (Vec::new(), Vec::new(), BTreeSet::new());
        Self { table: table(SLOTS), now: Duration::ZERO, actors, leases, iteration: 0, consumed }
    }

    fn happen(&mut self, happening: Happening) {
        match happening {
            Happening::Register => self.register(),
            Happening::Lease(at) => self.lease(at),
            Happening::Push { lease, skip } => self.push(lease, skip),
            Happening::Repeat(at) => self.repeat(at),
            Happening::Refuse(at) => {
                if let Some((lease, _)) = pick(&self.leases, at) {
                    self.table.refuse(lease.connection, Some(lease.id));
                }
            }
            Happening::Beat(at) => self.beat(at),
            Happening::Disconnect(at) => {
                if let Some(actor) = pick(&self.actors, at) {
                    self.table.disconnect(actor.connection);
                }
            }
            Happening::Pass(tenths) => {
                self.now += TTL * tenths / 10;
                self.table.tick(self.now);
            }
        }
        self.consume();
    }

    fn register(&mut self) {
        // Each actor has a connection of its own.
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
        assert!(!accepted || skip == 0, "a chunk was taken in although one before it is missing");
        *sent += 1;
    }

    fn repeat(&mut self, at: usize) {
        let sent = pick(&self.leases, at).filter(|(_, sent)| *sent > 0);
        let Some((lease, sent)) = sent else { return };
        // Refused if the lease has ended; never counted twice, which the end of the test shows.
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

    /// Takes complete iterations out, as the trainer does, and opens the next one.
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
                    self.table.open_iteration(
                        self.iteration,
                        weights(),
                        works(self.iteration, SLOTS),
                    );
                }
                other => panic!("honest actors never cause {other:?}"),
            }
        }
    }

    /// One honest actor is left, and time enough.
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
fn every_slot_is_consumed_exactly_once_whatever_happens() {
    for_all(256, &proptest::collection::vec(happening(), 0..300), |happenings| {
        let mut world = World::new();
        happenings.into_iter().for_each(|happening| world.happen(happening));
        world.settle();
        let expected = (0..world.iteration).flat_map(|k| (0..SLOTS).map(move |slot| (k, slot)));
        assert!(world.consumed.iter().copied().eq(expected));
    });
}
