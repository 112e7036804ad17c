//! A small slot table, and an actor controlled by the test.

use std::ops::{Deref, DerefMut};
use std::time::Duration;

use learner::lease::sample::SecretSample;
use learner::lease::slots::{ConnectionId, Effect, Offer, ResultPart, SlotRules, SlotTable, Trust};
use proto::{
    Ack, ActorId, Digest, EnvironmentStart, EvaluationResult, Heartbeat, Incarnation, Lease,
    PolicyVersion, ProcessId, PushHeader, Refusal, RolloutWork, Start, TrajectoryChunk,
    WeightsName, Work,
};

pub(crate) const INCARNATION: Incarnation = Incarnation(11);
pub(crate) const TTL: Duration = Duration::from_secs(20);
/// A digest that no correct actor computes.
pub(crate) const OTHER: Digest = Digest([66; 32]);
/// Chunks of a slot.
pub(crate) const CHUNKS: u32 = 3;

pub(crate) fn second(count: u64) -> Duration {
    Duration::from_secs(count)
}

pub(crate) fn weights() -> WeightsName {
    WeightsName { version: PolicyVersion(3), digest: Digest([9; 32]) }
}

pub(crate) fn works(iteration: u64, slots: u32) -> Vec<RolloutWork> {
    let start = |environment| {
        let start = Start::Fresh { episode: iteration, limit: 10 };
        EnvironmentStart { environment, start }
    };
    (0..slots)
        .map(|slot| RolloutWork { iteration, slot, environments: vec![start(slot)] })
        .collect()
}

/// Rules without audits.
pub(crate) fn rules(incarnation: Incarnation) -> SlotRules {
    SlotRules {
        incarnation,
        ttl: TTL,
        chunks_per_slot: CHUNKS,
        steps_per_slot: 50,
        episode_steps: 1000,
        audit: SecretSample::NONE,
        requires_fingerprint: false,
    }
}

/// The rules of a start of the learner that audits every second slot.
pub(crate) fn half_audited(incarnation: Incarnation) -> SlotRules {
    SlotRules { audit: SecretSample { share: 0.5, secret: 3 }, ..rules(incarnation) }
}

/// A table with an open iteration of `slots` slots.
pub(crate) fn table(slots: u32) -> SlotTable {
    open(SlotTable::new(rules(INCARNATION)), slots)
}

/// A table whose slots are all audited.
pub(crate) fn audited_table(slots: u32) -> SlotTable {
    let audit = SecretSample { share: 1.0, secret: 5 };
    open(SlotTable::new(SlotRules { audit, ..rules(INCARNATION) }), slots)
}

fn open(mut table: SlotTable, slots: u32) -> SlotTable {
    table.open_iteration(weights(), works(0, slots));
    table.effects();
    table
}

/// A registered actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Actor {
    pub(crate) connection: ConnectionId,
    pub(crate) id: ActorId,
}

impl Actor {
    /// Requests a lease.
    pub(crate) fn ask(self, table: &mut SlotTable) -> Result<Offer, Refusal> {
        table.lease(self.connection, self.id, INCARNATION)
    }
}

/// A lease and the connection that holds it.
#[derive(Clone, Debug)]
pub(crate) struct Held {
    pub(crate) connection: ConnectionId,
    pub(crate) lease: Lease,
}

impl Deref for Held {
    type Target = Lease;

    fn deref(&self) -> &Lease {
        &self.lease
    }
}

impl DerefMut for Held {
    fn deref_mut(&mut self) -> &mut Lease {
        &mut self.lease
    }
}

/// Registers an exact actor on this connection.
pub(crate) fn actor(table: &mut SlotTable, connection: u64) -> Actor {
    let connection = ConnectionId(connection);
    Actor { connection, id: table.register(connection, Trust::Exact, None) }
}

/// Registers an exact actor of this process on this connection.
pub(crate) fn actor_of(table: &mut SlotTable, process: u8, connection: u64) -> Actor {
    let (connection, process) = (ConnectionId(connection), Some(ProcessId([process; 16])));
    Actor { connection, id: table.register(connection, Trust::Exact, process) }
}

pub(crate) fn lease(table: &mut SlotTable, actor: Actor) -> Held {
    match actor.ask(table).unwrap() {
        Offer::Lease(lease) => Held { connection: actor.connection, lease },
        other => panic!("expected a lease, got {other:?}"),
    }
}

pub(crate) fn slot(lease: &Lease) -> u32 {
    match &lease.work {
        Work::Rollout(work) => work.slot,
        Work::Evaluation(work) => panic!("expected a slot, got {work:?}"),
    }
}

/// The digest that every correct actor computes for a chunk.
pub(crate) fn honest(lease: &Lease, sequence: u32) -> Digest {
    let Work::Rollout(work) = &lease.work else { panic!("expected a slot, got {lease:?}") };
    Digest::of(format!("{} {} {sequence}", work.iteration, work.slot).as_bytes())
}

/// A chunk whose reward is the id of its lease.
pub(crate) fn chunk(lease: &Lease, sequence: u32) -> TrajectoryChunk {
    TrajectoryChunk {
        sequence,
        first_step: sequence,
        steps: 1,
        reward: vec![lease.id.0 as f32],
        ..TrajectoryChunk::default()
    }
}

pub(crate) fn push(table: &mut SlotTable, lease: &Held, sequence: u32) -> Result<Ack, Refusal> {
    push_as(table, lease, sequence, honest(lease, sequence))
}

pub(crate) fn push_as(
    table: &mut SlotTable,
    lease: &Held,
    sequence: u32,
    digest: Digest,
) -> Result<Ack, Refusal> {
    let part = ResultPart::Chunk(chunk(lease, sequence));
    table.take(lease.connection, &PushHeader::of(lease, digest), part)
}

/// Pushes all chunks correctly and returns the table's effects.
pub(crate) fn complete(table: &mut SlotTable, lease: &Held) -> Vec<Effect> {
    for sequence in 0..CHUNKS {
        push(table, lease, sequence).unwrap();
    }
    table.effects()
}

/// Sends this return for the episode of the lease.
pub(crate) fn play(
    table: &mut SlotTable,
    lease: &Held,
    extrinsic_return: f64,
) -> Result<Ack, Refusal> {
    let Work::Evaluation(work) = lease.work else { panic!("expected an episode, got {lease:?}") };
    let (episode, steps, reward_terms) = (work.episode, 5, Vec::new());
    let result = EvaluationResult { episode, extrinsic_return, steps, reward_terms };
    let header = PushHeader::of(lease, result.digest(work.iteration));
    table.take(lease.connection, &header, ResultPart::Episode(result))
}

/// Sends a heartbeat of the lease, whose work is at this step.
pub(crate) fn beat(table: &mut SlotTable, actor: Actor, lease: &Held, slot_step: u32) -> bool {
    let beat = Heartbeat { actor: actor.id, incarnation: INCARNATION, lease: lease.id, slot_step };
    table.heartbeat(actor.connection, &beat).unwrap()
}
