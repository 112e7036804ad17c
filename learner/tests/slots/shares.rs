//! Processes that hold leases and deliver nothing, and processes that wait meanwhile.

use std::time::Duration;

use learner::lease::slots::{Incident, Offer, SlotTable};

use crate::table::{
    Actor, TTL, actor_of, beat, complete, lease, push, slot, table, weights, works,
};

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn expiries_in_a_row_count_like_refusals_and_leases_held_at_once_count_once() {
    let mut table = table(4);
    let silent = actor_of(&mut table, 1, 1);
    (0..4).for_each(|_| drop(lease(&mut table, silent)));
    for time in 1..3 {
        table.tick(TTL * time);
        lease(&mut table, silent);
        assert_eq!(silent.ask(&mut table), Ok(Offer::Nothing), "it holds one at most now");
    }
    table.incidents();
    table.tick(TTL * 3);
    let [Incident::Expired(_), Incident::Quarantined { actor, pause: TTL }] = table.incidents()[..]
    else {
        panic!("no quarantine")
    };
    assert_eq!((actor, silent.ask(&mut table)), (silent.id, Ok(Offer::Quarantined(TTL))));
}

#[test]
fn an_actor_that_finishes_a_slot_now_and_then_is_never_in_quarantine() {
    let mut table = table(20);
    let slow = actor_of(&mut table, 1, 1);
    for time in 1..9 {
        let late = lease(&mut table, slow);
        table.tick(TTL * time);
        assert!(!beat(&mut table, slow, &late, 1), "it has expired");
        if time % 2 == 0 {
            let done = lease(&mut table, slow);
            complete(&mut table, &done);
        }
    }
    assert!(matches!(slow.ask(&mut table), Ok(Offer::Lease(_))));
}

/// A table of four slots whose first process takes all of them while the second one waits; then the next iteration opens.
fn one_waits() -> (SlotTable, Actor, Actor) {
    let mut table = table(4);
    let (greedy, other) = (actor_of(&mut table, 1, 1), actor_of(&mut table, 2, 2));
    (0..4).for_each(|_| drop(lease(&mut table, greedy)));
    assert_eq!(other.ask(&mut table), Ok(Offer::Nothing));
    table.open_iteration(weights(), works(1, 4));
    (table, greedy, other)
}

#[test]
fn a_process_holds_no_more_than_its_share_while_another_one_waits() {
    let (mut table, greedy, other) = one_waits();
    let held = [lease(&mut table, greedy), lease(&mut table, greedy)];
    assert_eq!(held.each_ref().map(|lease| slot(lease)), [0, 1]);
    assert_eq!(greedy.ask(&mut table), Ok(Offer::Nothing));
    table.effects();
    assert_eq!(slot(&lease(&mut table, other)), 2);
    assert_eq!(table.effects().len(), 1, "those that were refused are notified");
    assert_eq!(slot(&lease(&mut table, greedy)), 3);
}

#[test]
fn work_that_is_kept_for_a_process_that_does_not_come_is_free_after_a_second() {
    let (mut table, greedy, _gone) = one_waits();
    (0..2).for_each(|_| drop(lease(&mut table, greedy)));
    assert_eq!(greedy.ask(&mut table), Ok(Offer::Nothing));
    assert_eq!(table.next_deadline(), Some(SECOND));
    table.tick(SECOND);
    assert_eq!(slot(&lease(&mut table, greedy)), 2);
}

#[test]
fn a_process_whose_slots_others_finish_comes_last_and_is_backed_up_at_once() {
    let mut table = table(4);
    let (hoarder, honest) = (actor_of(&mut table, 1, 1), actor_of(&mut table, 2, 2));
    let done = lease(&mut table, honest);
    complete(&mut table, &done);
    (0..3).for_each(|_| drop(lease(&mut table, hoarder)));
    assert_eq!(honest.ask(&mut table), Ok(Offer::Nothing));
    table.tick(SECOND);
    for _ in 0..3 {
        let backup = lease(&mut table, honest);
        complete(&mut table, &backup);
    }
    assert_eq!(honest.ask(&mut table), Ok(Offer::Nothing));
    table.open_iteration(weights(), works(1, 3));
    assert_eq!(hoarder.ask(&mut table), Ok(Offer::Nothing), "another one waits");
    let first = lease(&mut table, honest);
    assert_eq!((slot(&first), slot(&lease(&mut table, hoarder))), (0, 1));
    assert_eq!(hoarder.ask(&mut table), Ok(Offer::Nothing), "it holds one");
    assert_eq!(slot(&lease(&mut table, honest)), 2);
    assert_eq!(slot(&lease(&mut table, honest)), 1, "a backup at once");
}

#[test]
fn a_slow_actor_that_sends_chunks_loses_nothing_when_others_finish_its_slots() {
    let mut table = table(5);
    let (slow, quick) = (actor_of(&mut table, 1, 1), actor_of(&mut table, 2, 2));
    let done = lease(&mut table, quick);
    complete(&mut table, &done);
    let held = [(); 4].map(|()| lease(&mut table, slow));
    held.iter().for_each(|lease| drop(push(&mut table, lease, 0)));
    table.tick(SECOND);
    for _ in 0..4 {
        let backup = lease(&mut table, quick);
        complete(&mut table, &backup);
    }
    table.open_iteration(weights(), works(1, 2));
    assert_eq!(slot(&lease(&mut table, slow)), 0);
    assert_eq!(slot(&lease(&mut table, slow)), 1);
}

#[test]
fn two_processes_that_hold_a_slot_and_its_backup_do_not_keep_it_from_a_third() {
    let mut table = table(1);
    let [first, second, honest] =
        [1, 2, 3].map(|process| actor_of(&mut table, process, process.into()));
    let held = lease(&mut table, first);
    table.tick(TTL - SECOND);
    assert!(beat(&mut table, first, &held, 1));
    table.tick(TTL);
    assert!(beat(&mut table, first, &held, 1));
    let backup = lease(&mut table, second);
    table.tick(TTL * 2 - SECOND);
    assert!(beat(&mut table, first, &held, 2) && beat(&mut table, second, &backup, 1));
    assert_eq!(honest.ask(&mut table), Ok(Offer::Nothing));
    table.tick(TTL * 2);
    let third = lease(&mut table, honest);
    assert!(beat(&mut table, first, &held, 3), "the first lease is never replaced");
    assert!(!beat(&mut table, second, &backup, 2));
    table.effects();
    assert_eq!(complete(&mut table, &third).len(), 1);
}
