//! Accepted, repeated and refused results, and results that contradict each other.

use learner::lease::slots::{ConnectionId, Effect, Part, SlotTable, Trust};
use proto::{AckState, ActorId, Digest, PolicyVersion, Reason};

use crate::table::{Actor, OTHER, actor, complete, honest, lease, push, push_as, table};

fn rollouts(effects: &[Effect]) -> Vec<(u32, ActorId)> {
    let [Effect::Iteration(rollouts)] = effects else { panic!("no iteration: {effects:?}") };
    rollouts.iter().map(|rollout| (rollout.slot, rollout.actor)).collect()
}

/// Leases the slot, pushes chunk 0 with `digest`, and disconnects.
fn disconnect_after(table: &mut SlotTable, connection: u64, digest: Digest) {
    let actor = actor(table, connection);
    let lease = lease(table, actor);
    push_as(table, &lease, 0, digest).unwrap();
    table.disconnect(ConnectionId(connection));
    table.effects();
}

#[test]
fn a_repeated_chunk_is_acknowledged_again_even_when_the_lease_is_finished() {
    let mut table = table(1);
    let a = actor(&mut table, 1);
    let lease = lease(&mut table, a);
    assert_eq!(push(&mut table, &lease, 0).unwrap().state, AckState::Accepted);
    let again = push(&mut table, &lease, 0).unwrap();
    assert_eq!((again.state, again.lease_finished), (AckState::Repeated, false));
    push(&mut table, &lease, 1).unwrap();
    assert_eq!(table.counts().chunks, 2);
    assert!(push(&mut table, &lease, 2).unwrap().lease_finished);
    let again = push(&mut table, &lease, 2).unwrap();
    assert_eq!((again.state, again.lease_finished), (AckState::Repeated, true));
    assert_eq!(table.effects().len(), 1);
}

#[test]
fn chunks_out_of_order_or_with_other_content_or_weights_are_refused() {
    let mut table = table(1);
    let a = actor(&mut table, 1);
    let mut lease = lease(&mut table, a);
    let refusal = push(&mut table, &lease, 1).unwrap_err();
    assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::OutOfOrder, "chunk.sequence"));
    push(&mut table, &lease, 0).unwrap();
    assert_eq!(push_as(&mut table, &lease, 0, OTHER).unwrap_err().reason, Reason::DigestConflict);
    for version in [2, 4, 1003] {
        lease.weights.version = PolicyVersion(version);
        let refusal = push(&mut table, &lease, 1).unwrap_err();
        assert_eq!(
            (refusal.reason, refusal.field.as_str()),
            (Reason::StaleWeights, "weights.version")
        );
    }
    lease.weights.version = PolicyVersion(3);
    lease.weights.digest = OTHER;
    assert_eq!(push(&mut table, &lease, 1).unwrap_err().field, "weights.digest");
}

#[test]
fn a_result_that_agrees_with_an_unfinished_one_is_accepted() {
    let mut table = table(1);
    let probe = actor(&mut table, 1);
    let digest = honest(&lease(&mut table, probe), 0);
    table.disconnect(ConnectionId(1));
    disconnect_after(&mut table, 2, digest);
    let a = actor(&mut table, 3);
    let lease = lease(&mut table, a);
    assert_eq!(rollouts(&complete(&mut table, &lease)), [(0, a.id)]);
}

#[test]
fn a_result_that_contradicts_an_unfinished_one_is_accepted_after_a_second_computation() {
    let mut table = table(1);
    disconnect_after(&mut table, 1, OTHER);
    let (a, b) = (actor(&mut table, 2), actor(&mut table, 3));
    let first = lease(&mut table, a);
    assert_eq!(complete(&mut table, &first), [Effect::WorkFreed]);
    let second = lease(&mut table, b);
    assert_eq!(rollouts(&complete(&mut table, &second)), [(0, b.id)]);
}

#[test]
fn two_complete_results_that_differ_stop_the_run_and_name_their_actors() {
    let mut table = table(1);
    disconnect_after(&mut table, 1, OTHER);
    let (a, b) = (actor(&mut table, 2), actor(&mut table, 3));
    let first = lease(&mut table, a);
    assert_eq!(complete(&mut table, &first), [Effect::WorkFreed]);
    let second = lease(&mut table, b);
    push(&mut table, &second, 0).unwrap();
    push_as(&mut table, &second, 1, OTHER).unwrap();
    push(&mut table, &second, 2).unwrap();
    let [Effect::Failed(found)] = &table.effects()[..] else { panic!("no failure") };
    assert_eq!(found.part, Part::Chunk { slot: 0, sequence: 1 });
    assert_eq!((found.first.actor, found.second.actor, found.second.digest), (a.id, b.id, OTHER));
}

#[test]
fn results_of_a_foreign_actor_are_never_compared() {
    let mut table = table(1);
    disconnect_after(&mut table, 1, OTHER);
    let connection = ConnectionId(2);
    let foreign = Actor { connection, id: table.register(connection, Trust::Foreign, None) };
    let lease = lease(&mut table, foreign);
    assert_eq!(table.counts().foreign, 0, "it has registered only");
    assert_eq!(rollouts(&complete(&mut table, &lease)), [(0, foreign.id)]);
    assert_eq!(table.counts().foreign, 1);
}
