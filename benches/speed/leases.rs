//! Duration of the slot table's calls by number of actors. One lock guards the table, so these calls come one after the
//! other.

use std::time::Duration;

use learner::sample::SecretSample;
use learner::slots::{ConnectionId, Offer, SlotRules, SlotTable, Trust};
use proto::{
    ActorId, Digest, Heartbeat, Incarnation, Lease, PolicyVersion, RolloutWork, WeightsName,
};

use anyhow::bail;

use crate::Effort;
use crate::clock::typical;
use crate::table::Row;

const INCARNATION: Incarnation = Incarnation(1);
/// Calls of one measurement.
const CALLS: u32 = 100;

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<Row>> {
    [10, 100, 1_000, 10_000].into_iter().map(|actors| row(actors, effort)).collect()
}

/// A table in which every actor holds a lease, and one more finds nothing to do.
fn row(actors: u64, effort: Effort) -> anyhow::Result<Row> {
    let mut table = table(actors as u32);
    let mut held = Vec::new();
    for index in 0..actors {
        let (connection, actor) = register(&mut table, index);
        let offer = table.lease(connection, actor, INCARNATION)?;
        let Offer::Lease(lease) = offer else { bail!("a slot is free, but not leased") };
        held.push((connection, actor, lease));
    }
    let (connection, actor) = register(&mut table, actors);
    let request = micros(effort, || {
        table.tick(Duration::ZERO);
        let _ = table.lease(connection, actor, INCARNATION);
        let _ = table.next_deadline();
    });
    let (connection, actor, Lease { id, .. }) = held[held.len() / 2];
    let beat = Heartbeat { actor, incarnation: INCARNATION, lease: id, slot_step: 0 };
    let mut now = Duration::ZERO;
    let heartbeat = micros(effort, || {
        // Each one extends the lease.
        now += Duration::from_nanos(1);
        table.tick(now);
        let _ = table.heartbeat(connection, &beat);
    });
    let figures = vec![("request for work, µs", request), ("heartbeat, µs", heartbeat)];
    Ok(Row { case: format!("{actors} actors with a lease"), figures })
}

fn table(slots: u32) -> SlotTable {
    let mut table = SlotTable::new(SlotRules {
        incarnation: INCARNATION,
        ttl: Duration::from_secs(20),
        chunks_per_slot: 1,
        steps_per_slot: 1,
        episode_steps: 1,
        audit: SecretSample::NONE,
        requires_fingerprint: false,
    });
    let weights = WeightsName { version: PolicyVersion(0), digest: Digest([0; 32]) };
    let work = |slot| RolloutWork { iteration: 0, slot, environments: Vec::new() };
    table.open_iteration(0, weights, (0..slots).map(work).collect());
    table
}

fn register(table: &mut SlotTable, connection: u64) -> (ConnectionId, ActorId) {
    (ConnectionId(connection), table.register(ConnectionId(connection), Trust::Exact, None))
}

/// Processor time of one call, microseconds.
fn micros(effort: Effort, mut call: impl FnMut()) -> f64 {
    let took = typical(effort.repeats, || (0..CALLS).for_each(|_| call()));
    took.thread / f64::from(CALLS) * 1e6
}
