//! Granting, renewal and expiry of leases.

use learner::lease::slots::{ConnectionId, Effect, Incident, Offer};
use proto::{ActorId, Heartbeat, Incarnation, Reason, Work};

use crate::table::{
    INCARNATION, TTL, actor, beat, complete, lease, play, push, second, slot, table, weights, works,
};

#[test]
fn the_lowest_free_slot_is_leased_first() {
    let mut table = table(3);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, a);
    assert_eq!((slot(&first), slot(&lease(&mut table, b))), (0, 1));
    table.refuse(first.connection, Some(first.id));
    assert_eq!((slot(&lease(&mut table, b)), slot(&lease(&mut table, b))), (0, 2));
    assert_eq!(a.ask(&mut table), Ok(Offer::Nothing));
}

#[test]
fn evaluations_are_leased_when_no_slot_is_free_and_end_after_their_last_episode() {
    let mut table = table(1);
    table.open_evaluation(7, weights(), 2);
    let a = actor(&mut table, 1);
    assert_eq!(slot(&lease(&mut table, a)), 0);
    table.effects();
    let episodes = [lease(&mut table, a), lease(&mut table, a)];
    for (i, lease) in episodes.iter().enumerate().rev() {
        let Work::Evaluation(work) = lease.work else { panic!("{lease:?}") };
        assert_eq!((work.iteration, work.episode), (7, i as u32));
        assert!(play(&mut table, lease, i as f64).unwrap().lease_finished);
    }
    let [Effect::Evaluation(outcome)] = &table.effects()[..] else { panic!("no outcome") };
    let returns = outcome.episodes.iter().map(|episode| episode.extrinsic_return);
    assert_eq!((outcome.iteration, returns.collect::<Vec<_>>()), (7, vec![0.0, 1.0]));
}

#[test]
fn a_lease_without_messages_expires_after_its_time_to_live_and_the_slot_starts_again() {
    let mut table = table(1);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    let late = lease(&mut table, a);
    push(&mut table, &late, 0).unwrap();
    table.tick(TTL - second(1));
    assert_eq!(b.ask(&mut table), Ok(Offer::Nothing));
    table.tick(TTL);
    assert_eq!(table.effects(), [Effect::WorkFreed]);
    let again = lease(&mut table, b);
    assert_eq!(push(&mut table, &again, 1).unwrap_err().reason, Reason::OutOfOrder);
    assert_eq!(push(&mut table, &late, 1).unwrap_err().reason, Reason::UnknownLease);
    assert_eq!(table.counts().reissued, 1);
}

#[test]
fn heartbeats_extend_a_lease_only_for_a_limited_time() {
    // A slot without chunks for six times to live, an episode whose steps rise for ninety.
    for (slots, times) in [(1, 6), (0, 90)] {
        let mut table = table(slots);
        table.open_evaluation(0, weights(), 1);
        let a = actor(&mut table, 1);
        let lease = lease(&mut table, a);
        for step in 1..times * 20 / 15 {
            table.tick(second(15 * u64::from(step)));
            assert!(beat(&mut table, a, &lease, step), "{times} times to live, step {step}");
        }
        table.tick(times * TTL);
        let last = beat(&mut table, a, &lease, times * 20 / 15 + 1);
        assert!(!last, "{times} times to live");
    }
}

#[test]
fn more_steps_than_the_work_has_are_refused() {
    let mut table = table(1);
    let a = actor(&mut table, 1);
    let lease = lease(&mut table, a);
    let beat = Heartbeat { actor: a.id, incarnation: INCARNATION, lease: lease.id, slot_step: 51 };
    let refusal = table.heartbeat(a.connection, &beat).unwrap_err();
    assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::BadValue, "slot_step"));
    assert_eq!(refusal.detail, "51, the work has 50 steps");
}

#[test]
fn a_closed_connection_frees_its_leases_at_once() {
    let mut table = table(2);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    let gone = [lease(&mut table, a), lease(&mut table, a)];
    table.disconnect(ConnectionId(1));
    let incidents = table.incidents();
    let [Incident::Gone { actor, leases }] = &incidents[..] else { panic!("{incidents:?}") };
    let ended = leases.iter().map(|lease| lease.lease).collect::<Vec<_>>();
    assert_eq!((*actor, ended), (a.id, gone.iter().map(|lease| lease.id).collect::<Vec<_>>()));
    assert_eq!((slot(&lease(&mut table, b)), table.counts().actors), (0, 1));
    assert_eq!(push(&mut table, &gone[0], 0).unwrap_err().reason, Reason::UnknownLease);
    assert_eq!(a.ask(&mut table).unwrap_err().reason, Reason::UnknownActor);
}

#[test]
fn another_incarnation_and_an_unknown_actor_are_refused() {
    let mut table = table(1);
    let a = actor(&mut table, 1);
    let other = Incarnation(10);
    for (id, incarnation, reason) in
        [(a.id, other, Reason::OtherIncarnation), (ActorId(99), INCARNATION, Reason::UnknownActor)]
    {
        assert_eq!(table.lease(a.connection, id, incarnation).unwrap_err().reason, reason);
    }
    let mut lease = lease(&mut table, a);
    lease.incarnation = other;
    assert_eq!(push(&mut table, &lease, 0).unwrap_err().reason, Reason::OtherIncarnation);
}

#[test]
fn an_actor_holds_four_leases_at_most() {
    let mut table = table(5);
    let a = actor(&mut table, 1);
    (0..4).for_each(|_| drop(lease(&mut table, a)));
    assert_eq!(a.ask(&mut table).unwrap_err().reason, Reason::TooManyLeases);
}

#[test]
fn an_actor_that_is_refused_three_times_in_a_row_waits_while_others_work() {
    let mut table = table(1);
    let (bad, good) = (actor(&mut table, 1), actor(&mut table, 2));
    for _ in 0..3 {
        let lease = lease(&mut table, bad);
        table.refuse(lease.connection, Some(lease.id));
    }
    assert_eq!(bad.ask(&mut table), Ok(Offer::Quarantined(TTL)));
    let kept = lease(&mut table, good);
    table.refuse(kept.connection, Some(kept.id));
    table.tick(TTL);
    assert_eq!(slot(&lease(&mut table, bad)), 0);
}

#[test]
fn leases_of_an_iteration_end_when_the_next_one_opens() {
    let mut table = table(1);
    let a = actor(&mut table, 1);
    let old = lease(&mut table, a);
    table.open_iteration(weights(), works(1, 1));
    assert_eq!(push(&mut table, &old, 0).unwrap_err().reason, Reason::UnknownLease);
    table.effects();
    let lease = lease(&mut table, a);
    assert!(matches!(complete(&mut table, &lease)[..], [Effect::Iteration(_)]));
}

#[test]
fn the_seventeenth_registration_of_a_connection_removes_its_first_actor() {
    let mut table = table(1);
    let first = actor(&mut table, 1);
    let held = lease(&mut table, first);
    (0..15).for_each(|_| assert_ne!(actor(&mut table, 1), first));
    let other = actor(&mut table, 2);
    assert_eq!((table.counts().actors, other.ask(&mut table)), (17, Ok(Offer::Nothing)));
    actor(&mut table, 1);
    assert_eq!(table.counts().actors, 17);
    assert_eq!(push(&mut table, &held, 0).unwrap_err().reason, Reason::UnknownLease);
    assert_eq!(slot(&lease(&mut table, other)), 0);
}
