//! Leases that actors return: other processes try the work, then it begins again or ends the run.

use std::time::Duration;

use learner::lease::slots::{Effect, Offer, SlotTable};
use proto::{
    EnvironmentStart, LeaseFailure, LeasedWork, ReturnedLease, RolloutOrigin, RolloutWork, Start,
};

use crate::table::{
    Actor, Held, INCARNATION, TTL, actor, audited_table, beat, complete, lease, play, second, slot,
    table, weights, works,
};

/// Returns a lease; the table's effects besides those that wake actors.
fn give_back(
    table: &mut SlotTable,
    (owner, held): (Actor, &Held),
    failure: LeaseFailure,
) -> Vec<Effect> {
    let returned = ReturnedLease {
        actor: owner.id,
        incarnation: INCARNATION,
        lease: held.id,
        failure,
        detail: "broken".to_owned(),
    };
    table.give_back(owner.connection, &returned).unwrap();
    let mut effects = table.effects();
    effects.retain(|effect| *effect != Effect::WorkFreed);
    effects
}

/// The only slot of iteration 1 with this start.
fn work(start: Start) -> RolloutWork {
    let environments = vec![EnvironmentStart { environment: 0, start }];
    RolloutWork { iteration: 1, slot: 0, environments }
}

fn continued() -> RolloutWork {
    work(Start::Continue { state: vec![7], recurrent: Vec::new() })
}

#[test]
fn a_slot_whose_start_state_two_actors_cannot_restore_waits_for_another_start() {
    let mut table = table(1);
    table.open_iteration(weights(), vec![continued()]);
    let [one, two, _silent] = [1, 2, 3].map(|connection| actor(&mut table, connection));
    let held = lease(&mut table, one);
    assert_eq!(give_back(&mut table, (one, &held), LeaseFailure::StartState), []);
    assert_eq!(one.ask(&mut table), Ok(Offer::Nothing), "another process tries it first");
    let held = lease(&mut table, two);
    let origin = RolloutOrigin { iteration: 1, slot: 0, environments: vec![0] };
    assert_eq!(
        give_back(&mut table, (two, &held), LeaseFailure::StartState),
        [Effect::BeginAgain(origin)]
    );
    table.tick(TTL * 2);
    assert_eq!(two.ask(&mut table), Ok(Offer::Nothing), "it has no start state that is valid");
    table.replace(work(Start::Fresh { episode: 3, limit: 10 }));
    assert_eq!(table.effects(), [Effect::WorkFreed], "waiting actors are notified");
    let held = lease(&mut table, one);
    assert!(matches!(complete(&mut table, &held)[..], [Effect::Iteration(_)]));
}

#[test]
fn one_actor_alone_begins_no_new_episodes_while_another_has_not_tried() {
    let mut table = table(1);
    table.open_iteration(weights(), vec![continued()]);
    let [one, busy] = [1, 2].map(|connection| actor(&mut table, connection));
    for times in 1..=2 {
        let held = lease(&mut table, one);
        assert_eq!(give_back(&mut table, (one, &held), LeaseFailure::StartState), []);
        table.tick(TTL * times);
    }
    let held = lease(&mut table, busy);
    assert!(matches!(complete(&mut table, &held)[..], [Effect::Iteration(_)]));
}

#[test]
fn a_process_that_is_alone_tries_again_and_work_that_always_fails_ends_the_run() {
    let mut table = table(2);
    let own = actor(&mut table, 1);
    for _ in 0..4 {
        let held = lease(&mut table, own);
        assert_eq!(slot(&held), 0);
        assert_eq!(give_back(&mut table, (own, &held), LeaseFailure::Environment), []);
    }
    let held = lease(&mut table, own);
    let given_up = Effect::GivenUp {
        actor: own.id,
        work: LeasedWork::Slot(0),
        times: 5,
        detail: "broken".to_owned(),
    };
    assert_eq!(give_back(&mut table, (own, &held), LeaseFailure::Environment), [given_up]);
}

#[test]
fn a_slot_that_continues_episodes_begins_again_after_four_failures() {
    let mut table = table(1);
    table.open_iteration(weights(), vec![continued()]);
    let actors = [actor(&mut table, 1), actor(&mut table, 2)];
    for times in 1..=4 {
        let own = actors[times % 2];
        let held = lease(&mut table, own);
        let effects = give_back(&mut table, (own, &held), LeaseFailure::Environment);
        assert_eq!(matches!(effects[..], [Effect::BeginAgain(_)]), times == 4, "{effects:?}");
        table.tick(TTL * times as u32);
    }
}

#[test]
fn a_short_outage_of_an_environment_ends_no_episode() {
    let mut table = table(1);
    table.open_iteration(weights(), vec![continued()]);
    let [one, two] = [1, 2].map(|connection| actor(&mut table, connection));
    let fail = |table: &mut SlotTable, own| {
        let held = lease(table, own);
        assert_eq!(give_back(table, (own, &held), LeaseFailure::Environment), []);
    };
    fail(&mut table, one);
    fail(&mut table, two);
    let waits =
        |table: &mut SlotTable| [one, two].iter().all(|own| own.ask(table) == Ok(Offer::Nothing));
    // After the first failure at once.
    for end in [TTL / 4, TTL * 3 / 4] {
        table.tick(end - Duration::from_millis(1));
        assert!(waits(&mut table));
        assert_eq!(table.next_deadline(), Some(end), "waiting actors are woken");
        table.tick(end);
        if end < TTL / 2 {
            fail(&mut table, one);
        }
    }
    let held = lease(&mut table, two);
    assert!(matches!(complete(&mut table, &held)[..], [Effect::Iteration(_)]));
}

#[test]
fn a_process_that_fails_waits_for_one_that_has_not_tried_but_not_forever() {
    let mut table = table(1);
    let (own, _silent) = (actor(&mut table, 1), actor(&mut table, 2));
    for times in 1..=6 {
        let held = lease(&mut table, own);
        let effects = give_back(&mut table, (own, &held), LeaseFailure::Environment);
        assert_eq!(matches!(effects[..], [Effect::GivenUp { times: 6, .. }]), times == 6);
        table.tick(TTL * times - second(1));
        assert_eq!(own.ask(&mut table), Ok(Offer::Nothing), "the other one tries it first");
        table.tick(TTL * times);
    }
}

#[test]
fn failures_are_forgotten_when_the_work_is_done() {
    let mut table = table(1);
    let own = actor(&mut table, 1);
    for iteration in 0..3 {
        table.open_iteration(weights(), works(iteration, 1));
        for _ in 0..4 {
            let held = lease(&mut table, own);
            assert_eq!(give_back(&mut table, (own, &held), LeaseFailure::Environment), []);
        }
        let held = lease(&mut table, own);
        assert!(matches!(complete(&mut table, &held)[..], [Effect::Iteration(_)]));
    }
}

#[test]
fn an_actor_cannot_return_the_lease_of_another_or_a_lease_that_has_ended() {
    let mut table = table(1);
    let (one, two) = (actor(&mut table, 1), actor(&mut table, 2));
    let held = lease(&mut table, one);
    for _ in 0..9 {
        assert_eq!(give_back(&mut table, (two, &held), LeaseFailure::StartState), []);
    }
    assert!(matches!(complete(&mut table, &held)[..], [Effect::Iteration(_)]));
    assert_eq!(give_back(&mut table, (one, &held), LeaseFailure::StartState), []);
    assert_eq!(table.incidents(), []);
}

#[test]
fn a_returned_audit_is_skipped() {
    let mut table = audited_table(1);
    let (one, two) = (actor(&mut table, 1), actor(&mut table, 2));
    let held = lease(&mut table, one);
    complete(&mut table, &held);
    table.tick(Duration::from_secs(1));
    let audit = lease(&mut table, two);
    assert_eq!(give_back(&mut table, (two, &audit), LeaseFailure::StartState), []);
    assert_eq!((table.counts().audits.skipped, two.ask(&mut table)), (1, Ok(Offer::Nothing)));
}

#[test]
fn an_evaluation_does_not_wait_for_an_audit_that_was_returned() {
    let mut table = audited_table(0);
    table.open_evaluation(7, weights(), 1);
    let (one, two) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, one);
    play(&mut table, &first, 1.0).unwrap();
    let audit = lease(&mut table, two);
    table.effects();
    let effects = give_back(&mut table, (two, &audit), LeaseFailure::Environment);
    assert!(matches!(effects[..], [Effect::Evaluation(_)]), "{effects:?}");
    assert_eq!((table.counts().audits.skipped, two.ask(&mut table)), (1, Ok(Offer::Nothing)));
}

#[test]
fn work_that_fails_under_its_lease_and_its_backup_is_given_up() {
    let mut table = table(1);
    let (one, two) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, one);
    table.tick(TTL / 2);
    beat(&mut table, one, &first, 1);
    table.tick(TTL);
    let backup = lease(&mut table, two);
    assert_eq!(give_back(&mut table, (one, &first), LeaseFailure::Environment), []);
    assert_eq!(one.ask(&mut table), Ok(Offer::Nothing), "it has failed, so it is no backup");
    assert_eq!(give_back(&mut table, (two, &backup), LeaseFailure::Environment), []);
    for times in 2..=5 {
        let held = lease(&mut table, one);
        let effects = give_back(&mut table, (one, &held), LeaseFailure::Environment);
        assert_eq!(matches!(effects[..], [Effect::GivenUp { .. }]), times == 5, "{effects:?}");
    }
}

#[test]
fn work_that_a_process_may_not_try_is_not_kept_for_it() {
    let mut table = table(3);
    let (one, two) = (actor(&mut table, 1), actor(&mut table, 2));
    let failed = lease(&mut table, one);
    lease(&mut table, two);
    give_back(&mut table, (one, &failed), LeaseFailure::Environment);
    let other = lease(&mut table, one);
    complete(&mut table, &other);
    assert_eq!(one.ask(&mut table), Ok(Offer::Nothing), "another process tries it first");
    assert_eq!(slot(&lease(&mut table, two)), 0);
    assert!(table.next_deadline() > Some(Duration::ZERO), "no deadline has passed");
    table.disconnect(two.connection);
    assert!(table.effects().contains(&Effect::WorkFreed));
    assert_eq!(slot(&lease(&mut table, one)), 0, "no other process is left");
}
