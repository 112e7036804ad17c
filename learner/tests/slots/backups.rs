//! Messages over the wrong connection, and slots that two actors compute: backups of slow slots, and audits.

use learner::lease::slots::{ConnectionId, Effect, Offer, Part, SlotTable};
use learner::observe::snapshot::AuditCounts;
use proto::{AckState, Heartbeat, Reason};

use crate::table::{
    Actor, Held, INCARNATION, OTHER, TTL, actor, actor_of, audited_table, beat, complete, lease,
    push, push_as, second, slot, table, weights, works,
};

/// Sends heartbeats for longer than a time to live.
fn stay_alive(table: &mut SlotTable, actor: Actor, lease: &Held) {
    for time in [15, 30] {
        table.tick(second(time));
        assert!(beat(table, actor, lease, 1));
    }
}

#[test]
fn messages_over_another_connection_do_not_end_a_lease_and_count_against_their_sender() {
    let mut table = table(1);
    let (owner, other) = (actor(&mut table, 1), actor(&mut table, 2));
    let held = lease(&mut table, owner);
    let stolen = Held { connection: other.connection, ..held.clone() };
    for connection in [other.connection, ConnectionId(77)] {
        for _ in 0..3 {
            let pushed = push(&mut table, &Held { connection, ..stolen.clone() }, 0);
            assert_eq!(pushed.unwrap_err().reason, Reason::OtherConnection);
            table.refuse(connection, Some(held.id));
        }
    }
    let beat =
        Heartbeat { actor: owner.id, incarnation: INCARNATION, lease: held.id, slot_step: 1 };
    let refusal = table.heartbeat(other.connection, &beat).unwrap_err();
    assert_eq!(refusal.reason, Reason::UnknownActor);
    let asked = table.lease(other.connection, owner.id, INCARNATION).unwrap_err();
    assert_eq!(asked.reason, Reason::UnknownActor);
    assert_eq!(other.ask(&mut table), Ok(Offer::Quarantined(TTL)));
    assert_eq!(table.heartbeat(owner.connection, &beat), Ok(true));
    assert!(matches!(complete(&mut table, &held)[..], [Effect::Iteration(_)]));
}

#[test]
fn an_idle_actor_backs_up_the_longest_held_slot_once_it_is_slow() {
    let mut table = table(3);
    let (slow, quick) = (actor(&mut table, 1), actor(&mut table, 2));
    let stuck = lease(&mut table, slow);
    push(&mut table, &stuck, 0).unwrap();
    for _ in 0..2 {
        let done = lease(&mut table, quick);
        table.tick(second(2 * u64::from(slot(&done))));
        complete(&mut table, &done);
    }
    // Each slot took two seconds.
    assert_eq!(quick.ask(&mut table), Ok(Offer::Nothing));
    assert_eq!(table.next_deadline(), Some(second(6)));
    table.tick(second(6));
    assert_eq!(slow.ask(&mut table), Ok(Offer::Nothing), "an actor does not back up its own slot");
    let backup = lease(&mut table, quick);
    assert_eq!((slot(&backup), backup.attempt, table.counts().backups), (0, 1, 1));
    assert_eq!(actor(&mut table, 3).ask(&mut table), Ok(Offer::Nothing), "at most one backup");
    assert!(matches!(complete(&mut table, &backup)[..], [Effect::Iteration(_)]));
    // A late result is acknowledged as finished if it agrees, and refused otherwise.
    assert_eq!(push_as(&mut table, &stuck, 1, OTHER).unwrap_err().reason, Reason::DigestConflict);
    let late = push(&mut table, &stuck, 1).unwrap();
    assert_eq!((late.state, late.lease_finished), (AckState::Repeated, true));
}

#[test]
fn a_slot_continues_when_one_of_its_two_leases_ends() {
    let mut table = table(1);
    let (slow, quick) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, slow);
    stay_alive(&mut table, slow, &first);
    let backup = lease(&mut table, quick);
    table.disconnect(quick.connection);
    assert_eq!(push(&mut table, &backup, 0).unwrap_err().reason, Reason::UnknownLease);
    table.effects();
    assert!(matches!(complete(&mut table, &first)[..], [Effect::Iteration(_)]));
}

#[test]
fn a_process_does_not_back_up_its_own_slot_over_another_connection() {
    let mut table = table(1);
    let (slow, same) = (actor_of(&mut table, 1, 1), actor_of(&mut table, 1, 2));
    let first = lease(&mut table, slow);
    stay_alive(&mut table, slow, &first);
    assert_eq!(same.ask(&mut table), Ok(Offer::Nothing));
    let other = actor_of(&mut table, 2, 3);
    assert_eq!(slot(&lease(&mut table, other)), 0);
}

fn audits(agreed: u64, disagreed: u64, skipped: u64) -> AuditCounts {
    AuditCounts { agreed, disagreed, skipped }
}

#[test]
fn an_audited_slot_is_recomputed_by_another_actor_and_counted_if_it_agrees() {
    let mut table = audited_table(1);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, a);
    assert!(matches!(complete(&mut table, &first)[..], [Effect::WorkFreed, Effect::Iteration(_)]));
    let audit = lease(&mut table, b);
    assert_eq!((slot(&audit), audit.attempt), (0, 1));
    // The audit stays open in the next iteration.
    table.open_iteration(weights(), works(1, 1));
    table.effects();
    assert_eq!(complete(&mut table, &audit), []);
    assert_eq!(table.counts().audits, audits(1, 0, 0));
    assert_eq!(table.counts().complete_slots, 0);
}

#[test]
fn an_audit_that_differs_stops_the_run_and_names_both_actors() {
    let mut table = audited_table(1);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, a);
    complete(&mut table, &first);
    let audit = lease(&mut table, b);
    push(&mut table, &audit, 0).unwrap();
    push_as(&mut table, &audit, 1, OTHER).unwrap();
    push(&mut table, &audit, 2).unwrap();
    let [Effect::Failed(found)] = &table.effects()[..] else { panic!("no failure") };
    assert_eq!((found.iteration, found.part), (0, Part::Chunk { slot: 0, sequence: 1 }));
    assert_eq!((found.first.actor, found.second.actor, found.second.digest), (a.id, b.id, OTHER));
    assert_eq!(table.counts().audits, audits(0, 1, 0));
}

#[test]
fn an_audit_of_a_disconnected_actor_is_leased_again_and_the_oldest_of_too_many_is_skipped() {
    let mut table = audited_table(10);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    for _ in 0..10 {
        let done = lease(&mut table, a);
        complete(&mut table, &done);
    }
    assert_eq!((table.counts().audits, table.counts().open_audits), (audits(0, 0, 2), 8));
    let lost = lease(&mut table, b);
    assert_eq!(slot(&lost), 2);
    table.disconnect(b.connection);
    let c = actor(&mut table, 3);
    let again = lease(&mut table, c);
    table.effects();
    assert_eq!(slot(&again), 2);
    assert_eq!(complete(&mut table, &again), [], "the trainer already has the iteration");
    assert_eq!(table.counts().audits, audits(1, 0, 2));
}

#[test]
fn a_finished_run_answers_done_and_counts_its_open_audits_as_skipped() {
    let mut table = audited_table(1);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, a);
    complete(&mut table, &first);
    let audit = lease(&mut table, b);
    table.finish();
    assert_eq!(a.ask(&mut table), Ok(Offer::Done));
    assert_eq!((table.counts().audits, table.counts().open_audits), (audits(0, 0, 1), 0));
    assert_eq!(push(&mut table, &audit, 0).unwrap_err().reason, Reason::UnknownLease);
}

#[test]
fn a_slot_that_goes_on_with_its_backup_gets_no_other_backup_at_once() {
    let mut table = table(1);
    let (slow, quick, idle) = (actor(&mut table, 1), actor(&mut table, 2), actor(&mut table, 3));
    let first = lease(&mut table, slow);
    stay_alive(&mut table, slow, &first);
    let backup = lease(&mut table, quick);
    table.disconnect(slow.connection);
    assert_eq!(idle.ask(&mut table), Ok(Offer::Nothing));
    table.effects();
    assert!(matches!(complete(&mut table, &backup)[..], [Effect::Iteration(_)]));
}

#[test]
fn a_slot_is_audited_only_by_another_process() {
    let mut table = audited_table(2);
    let (a, same) = (actor_of(&mut table, 1, 1), actor_of(&mut table, 1, 2));
    let first = lease(&mut table, a);
    complete(&mut table, &first);
    let counted = (table.counts().open_audits, table.counts().audits);
    assert_eq!(counted, (0, audits(0, 0, 0)), "no other process is connected");
    let other = actor_of(&mut table, 2, 3);
    let second = lease(&mut table, a);
    complete(&mut table, &second);
    for own in [a, same] {
        assert_eq!(own.ask(&mut table), Ok(Offer::Nothing), "it computed the slot");
    }
    assert_eq!(slot(&lease(&mut table, other)), 1);
}

#[test]
fn a_slot_that_no_other_process_may_audit_soon_counts_as_skipped() {
    let mut table = audited_table(1);
    let (a, _silent) = (actor(&mut table, 1), actor(&mut table, 2));
    table.tick(second(61));
    let first = lease(&mut table, a);
    complete(&mut table, &first);
    assert_eq!((table.counts().audits, table.counts().open_audits), (audits(0, 0, 1), 0));
}
