//! The slot table with arbitrary calls: what it holds stays bounded, and a correct actor can still complete an iteration.
#![no_main]
#![expect(dead_code, reason = "the table's tests call more of what they share with this")]
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a finding")]

#[path = "../../learner/tests/slots/table.rs"]
mod table;

use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use learner::lease::slots::{ConnectionId, Effect, Offer, Preview, ResultPart, SlotTable, Trust};
use libfuzzer_sys::fuzz_target;
use proto::{
    AckState, ActorId, Digest, EvaluationResult, Heartbeat, Incarnation, LeaseId, PolicyVersion,
    ProcessId, PushHeader, WeightsName, Work,
};
use table::{CHUNKS, Held, INCARNATION, TTL, chunk, honest, weights, works};

const SLOTS: u32 = 3;
/// Longer lists of events show nothing that shorter ones do not.
const MOST_EVENTS: usize = 600;

fuzz_target!(|data: &[u8]| {
    // Too few bytes for a whole call end the list.
    let _ended = hostile_actors(&mut Unstructured::new(data));
});

/// A call of the table that a peer can cause. Numbers select connections, actors and leases.
#[derive(Arbitrary, Debug)]
enum Call {
    Register { connection: u8, foreign: bool, process: Option<u8> },
    Disconnect(u8),
    Lease { connection: u8, actor: u8, other_start: bool },
    Chunk { lease: u8, sequence: u8, lie: Lie },
    Evaluation { lease: u8, episode: u8, lie: Lie },
    Refuse { connection: u8, lease: u8 },
    Beat { connection: u8, actor: u8, lease: u8, step: u32 },
    Pass(u8),
    OpenIteration,
    OpenEvaluation(u8),
}

/// What is wrong with a message.
#[derive(Arbitrary, Clone, Copy, Debug, PartialEq, Eq)]
enum Lie {
    Nothing,
    Digest(u8),
    Version(u64),
    Start(u64),
    Lease(u64),
}

/// The table and what hostile actors know of it.
struct HostileActors {
    table: SlotTable,
    now: Duration,
    leases: Vec<Held>,
    iteration: u64,
    evaluations: u64,
    failed: bool,
}

fn hostile_actors(unstructured: &mut Unstructured<'_>) -> arbitrary::Result<()> {
    let mut actors = HostileActors {
        table: table::table(SLOTS),
        now: Duration::ZERO,
        leases: Vec::new(),
        iteration: 0,
        evaluations: 0,
        failed: false,
    };
    for _ in 0..MOST_EVENTS {
        if unstructured.is_empty() || actors.failed {
            break;
        }
        let call = Call::arbitrary(unstructured)?;
        actors.call(call);
        actors.take_effects();
        actors.is_bounded();
    }
    actors.a_correct_actor_completes_an_iteration();
    Ok(())
}

impl HostileActors {
    fn call(&mut self, call: Call) {
        match call {
            Call::Register { connection, foreign, process } => {
                let trust = if foreign { Trust::Foreign } else { Trust::Exact };
                let process = process.map(|process| ProcessId([process % 3; 16]));
                self.table.register(place(connection), trust, process);
            }
            Call::Disconnect(connection) => self.table.disconnect(place(connection)),
            Call::Lease { connection, actor, other_start } => {
                let incarnation = Incarnation(INCARNATION.0 + u64::from(other_start));
                let connection = place(connection);
                let offer = self.table.lease(connection, ActorId(actor.into()), incarnation);
                if let Ok(Offer::Lease(lease)) = offer {
                    self.leases.push(Held { connection, lease });
                }
            }
            Call::Chunk { lease, sequence, lie } => self.push(lease, sequence.into(), lie),
            Call::Evaluation { lease, episode, lie } => self.evaluate(lease, episode.into(), lie),
            Call::Refuse { connection, lease } => {
                self.table.refuse(place(connection), Some(LeaseId(lease.into())));
            }
            Call::Beat { connection, actor, lease, step } => {
                let (actor, lease) = (ActorId(actor.into()), LeaseId(lease.into()));
                let beat = Heartbeat { actor, incarnation: INCARNATION, lease, slot_step: step };
                let _valid = self.table.heartbeat(place(connection), &beat);
            }
            Call::Pass(tenths) => {
                self.now += TTL * u32::from(tenths) / 10;
                self.table.tick(self.now);
            }
            Call::OpenIteration => self.open_next(),
            Call::OpenEvaluation(episodes) if self.evaluations < 4 => {
                self.table.open_evaluation(
                    self.evaluations,
                    weights(),
                    u32::from(episodes % 3) + 1,
                );
                self.evaluations += 1;
            }
            Call::OpenEvaluation(_) => {}
        }
    }

    fn open_next(&mut self) {
        self.iteration += 1;
        self.table.open_iteration(weights(), works(self.iteration, SLOTS));
    }

    fn lease_at(&self, at: u8) -> Option<&Held> {
        usize::from(at).checked_rem(self.leases.len()).map(|at| &self.leases[at])
    }

    fn push(&mut self, lease: u8, sequence: u32, lie: Lie) {
        let Some(lease) = self.lease_at(lease).cloned() else { return };
        let Work::Rollout(_) = lease.work else { return };
        let header = bent(PushHeader::of(&lease, honest(&lease, sequence)), lie);
        let seen = self.table.preview(lease.connection, &header, Some(sequence));
        let taken =
            self.table.take(lease.connection, &header, ResultPart::Chunk(chunk(&lease, sequence)));
        // What would be taken is taken, and the other way round.
        let seen = seen.map(|preview| match preview {
            Preview::Next(_) => AckState::Accepted,
            Preview::Repeated(ack) => ack.state,
        });
        assert_eq!(seen, taken.map(|ack| ack.state));
    }

    fn evaluate(&mut self, lease: u8, episode: u32, lie: Lie) {
        let Some(lease) = self.lease_at(lease).cloned() else { return };
        let result = EvaluationResult { episode, extrinsic_return: 1.0, steps: 5 };
        let header = bent(PushHeader::of(&lease, result.digest(0)), lie);
        let _taken = self.table.take(lease.connection, &header, ResultPart::Episode(result));
    }

    fn take_effects(&mut self) {
        for effect in self.table.effects() {
            match effect {
                Effect::WorkFreed => {}
                Effect::Iteration(rollouts) => {
                    assert!(rollouts.iter().map(|rollout| rollout.slot).eq(0..SLOTS));
                    for rollout in rollouts {
                        let sequences = rollout.chunks.iter().map(|chunk| chunk.sequence);
                        assert!(sequences.eq(0..CHUNKS), "a slot is not whole");
                        assert_eq!(rollout.digests.len(), CHUNKS as usize);
                    }
                    self.open_next();
                }
                Effect::Evaluation(outcome) => assert!(outcome.iteration < self.evaluations),
                other @ (Effect::BeginAgain(_) | Effect::GivenUp { .. }) => {
                    panic!("no lease is returned, but the table wants {other:?}")
                }
                Effect::Failed(found) => {
                    assert_ne!(found.first.digest, found.second.digest);
                    self.failed = true;
                }
            }
        }
    }

    fn is_bounded(&self) {
        let held = self.table.counts();
        assert!(held.actors <= 4 * 16, "{held:?}");
        assert!(held.leases <= 2 * (SLOTS as usize + 4 * 3), "{held:?}");
        assert!(held.held_chunks <= 2 * u64::from(SLOTS * CHUNKS), "{held:?}");
        assert!(held.earlier_results <= 9 * SLOTS as usize, "{held:?}");
        assert!(held.finished_leases <= 4096, "{held:?}");
    }

    /// After old leases have ended, one correct actor on a separate connection completes an iteration.
    fn a_correct_actor_completes_an_iteration(&mut self) {
        if self.failed {
            return;
        }
        self.now += 100 * TTL;
        self.table.tick(self.now);
        self.open_next();
        let target = self.iteration + 1;
        let actor = table::actor(&mut self.table, 99);
        for _ in 0..SLOTS {
            let lease = table::lease(&mut self.table, actor);
            for sequence in 0..CHUNKS {
                table::push(&mut self.table, &lease, sequence).unwrap();
            }
            self.take_effects();
        }
        assert_eq!(self.iteration, target, "the iteration cannot be completed");
    }
}

/// One of four connections.
fn place(connection: u8) -> ConnectionId {
    ConnectionId(u64::from(connection % 4))
}

fn bent(header: PushHeader, lie: Lie) -> PushHeader {
    let WeightsName { digest, .. } = header.weights;
    match lie {
        Lie::Nothing => header,
        Lie::Digest(byte) => PushHeader { digest: Digest([byte; 32]), ..header },
        Lie::Start(start) => PushHeader { incarnation: Incarnation(start), ..header },
        Lie::Lease(lease) => PushHeader { lease: LeaseId(lease), ..header },
        Lie::Version(version) => {
            let weights = WeightsName { version: PolicyVersion(version), digest };
            PushHeader { weights, ..header }
        }
    }
}
