//! A slot table with small numbers, and an actor that does what a test says.

use std::time::Duration;

use learner::slots::{ConnectionId, Effect, Offer, SlotTable, Trust};
use proto::{
    Ack, ActorId, Digest, EnvironmentStart, Incarnation, Lease, PolicyVersion, PushHeader, Refusal,
    RolloutWork, Start, TrajectoryChunk, WeightsName, Work,
};

pub(crate) const INCARNATION: Incarnation = Incarnation(11);
pub(crate) const TTL: Duration = Duration::from_secs(20);
/// Chunks of a slot.
pub(crate) const CHUNKS: u32 = 3;

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

/// A table with an open iteration of `slots` slots.
pub(crate) fn table(slots: u32) -> SlotTable {
    let mut table = SlotTable::new(INCARNATION, TTL, CHUNKS);
    table.open_iteration(0, weights(), works(0, slots));
    table.effects();
    table
}

/// An actor on a connection of its own.
pub(crate) fn actor(table: &mut SlotTable, connection: u64) -> ActorId {
    table.register(ConnectionId(connection), Trust::Exact)
}

pub(crate) fn lease(table: &mut SlotTable, actor: ActorId) -> Lease {
    match table.lease(actor, INCARNATION).unwrap() {
        Offer::Lease(lease) => lease,
        other => panic!("expected a lease, got {other:?}"),
    }
}

pub(crate) fn slot(lease: &Lease) -> u32 {
    match &lease.work {
        Work::Rollout(work) => work.slot,
        Work::Evaluation(work) => panic!("expected a slot, got {work:?}"),
    }
}

/// What every honest actor computes for a chunk.
pub(crate) fn honest(lease: &Lease, sequence: u32) -> Digest {
    let Work::Rollout(work) = &lease.work else { panic!("expected a slot, got {lease:?}") };
    Digest::of(format!("{} {} {sequence}", work.iteration, work.slot).as_bytes())
}

/// A chunk that remembers under which lease it was computed.
pub(crate) fn chunk(lease: &Lease, sequence: u32) -> TrajectoryChunk {
    TrajectoryChunk {
        sequence,
        first_step: sequence,
        steps: 1,
        agents: Vec::new(),
        state: Vec::new(),
        reward: vec![lease.id.0 as f32],
        terminated: Vec::new(),
        truncated: Vec::new(),
        finals: Vec::new(),
        end: None,
    }
}

pub(crate) fn push(table: &mut SlotTable, lease: &Lease, sequence: u32) -> Result<Ack, Refusal> {
    push_as(table, lease, sequence, honest(lease, sequence))
}

pub(crate) fn push_as(
    table: &mut SlotTable,
    lease: &Lease,
    sequence: u32,
    digest: Digest,
) -> Result<Ack, Refusal> {
    table.chunk(&PushHeader::of(lease, digest), chunk(lease, sequence))
}

/// Pushes everything honestly, and hands back what the table wants done.
pub(crate) fn complete(table: &mut SlotTable, lease: &Lease) -> Vec<Effect> {
    for sequence in 0..CHUNKS {
        push(table, lease, sequence).unwrap();
    }
    table.effects()
}
