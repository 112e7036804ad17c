//! Evaluation episodes that two actors play: audits, and backups of slow ones. Actors that cannot be audited.

use learner::lease::slots::{ConnectionId, Effect, Offer, Part, SlotRules, SlotTable, Trust};
use learner::observe::snapshot::AuditCounts;
use proto::{Reason, Work};

use crate::table::{
    Actor, Held, INCARNATION, TTL, actor, audited_table, beat, complete, lease, play, rules, slot,
    table, weights, works,
};

/// A table that audits everything, with one open episode and two actors.
fn episode() -> (SlotTable, Actor, Actor) {
    let mut table = audited_table(0);
    table.open_evaluation(7, weights(), 1);
    let (a, b) = (actor(&mut table, 1), actor(&mut table, 2));
    table.effects();
    (table, a, b)
}

fn returns(effects: &[Effect]) -> Vec<f64> {
    let [Effect::Evaluation(outcome)] = effects else { panic!("no evaluation: {effects:?}") };
    outcome.episodes.iter().map(|episode| episode.extrinsic_return).collect()
}

fn episode_of(lease: &Held) -> u32 {
    let Work::Evaluation(work) = lease.work else { panic!("expected an episode, got {lease:?}") };
    work.episode
}

#[test]
fn an_evaluation_waits_until_another_process_has_played_its_audited_episode() {
    let (mut table, a, b) = episode();
    let first = lease(&mut table, a);
    play(&mut table, &first, 1.0).unwrap();
    assert_eq!(table.effects(), [Effect::WorkFreed]);
    assert_eq!(a.ask(&mut table), Ok(Offer::Nothing), "no actor audits itself");
    table.disconnect(a.connection);
    table.effects();
    let audit = lease(&mut table, b);
    assert_eq!((episode_of(&audit), audit.attempt), (0, 1));
    play(&mut table, &audit, 1.0).unwrap();
    assert_eq!(returns(&table.effects()), [1.0]);
    assert_eq!(table.counts().audits, AuditCounts { agreed: 1, ..AuditCounts::default() });
}

#[test]
fn a_forged_return_stops_the_run_and_names_both_actors() {
    let (mut table, a, b) = episode();
    let forged = lease(&mut table, a);
    play(&mut table, &forged, 4e10).unwrap();
    let audit = lease(&mut table, b);
    table.effects();
    play(&mut table, &audit, 1.0).unwrap();
    let [Effect::Failed(found)] = &table.effects()[..] else { panic!("no failure") };
    assert_eq!((found.iteration, found.part), (7, Part::Episode(0)));
    assert_eq!((found.first.actor, found.second.actor), (a.id, b.id));
    let line = found.to_string();
    assert!(line.starts_with("evaluation episode 0 of iteration 7: actor 1 gave"), "{line}");
}

#[test]
fn an_old_audit_of_an_episode_comes_before_slots_and_is_skipped_in_the_end() {
    let (mut table, a, b) = episode();
    let first = lease(&mut table, a);
    play(&mut table, &first, 1.0).unwrap();
    table.open_iteration(weights(), works(8, 2));
    assert_eq!(slot(&lease(&mut table, b)), 0);
    table.tick(TTL);
    let audit = lease(&mut table, b);
    assert_eq!(episode_of(&audit), 0);
    table.effects();
    table.tick(TTL * 3 - TTL / 10);
    assert!(!beat(&mut table, b, &audit, 5), "the audit has expired");
    assert!(table.effects().iter().all(|effect| *effect == Effect::WorkFreed));
    table.tick(TTL * 3);
    assert_eq!(returns(&table.effects()), [1.0]);
    assert_eq!(table.counts().audits, AuditCounts { skipped: 1, ..AuditCounts::default() });
}

#[test]
fn a_slow_episode_gets_a_backup_whatever_steps_its_actor_claims() {
    let mut table = table(0);
    table.open_evaluation(0, weights(), 1);
    let (slow, quick) = (actor(&mut table, 1), actor(&mut table, 2));
    let first = lease(&mut table, slow);
    table.tick(TTL / 2);
    assert!(beat(&mut table, slow, &first, 10));
    assert_eq!(quick.ask(&mut table), Ok(Offer::Nothing));
    assert_eq!(table.next_deadline(), Some(TTL));
    table.tick(TTL);
    let backup = lease(&mut table, quick);
    assert_eq!((episode_of(&backup), backup.attempt, table.counts().backups), (0, 1, 1));
    table.effects();
    play(&mut table, &backup, 1.0).unwrap();
    assert_eq!(returns(&table.effects()), [1.0]);
    assert!(play(&mut table, &first, 1.0).unwrap().lease_finished, "it is late, and right");
    assert_eq!(play(&mut table, &first, 2.0).unwrap_err().reason, Reason::DigestConflict);
}

#[test]
fn an_actor_without_a_fingerprint_gets_no_work_where_one_is_required() {
    let mut table = SlotTable::new(SlotRules { requires_fingerprint: true, ..rules(INCARNATION) });
    table.open_iteration(weights(), works(0, 1));
    let connection = ConnectionId(1);
    let foreign = Actor { connection, id: table.register(connection, Trust::Foreign, None) };
    let refusal = foreign.ask(&mut table).unwrap_err();
    assert_eq!((refusal.reason, &*refusal.field), (Reason::MissingField, "rollout_fingerprint"));
    assert_eq!((table.actors(), table.counts().foreign), (0, 0));
    let exact = actor(&mut table, 2);
    let done = lease(&mut table, exact);
    table.effects();
    assert!(matches!(complete(&mut table, &done)[..], [Effect::Iteration(_)]));
}

#[test]
fn an_evaluation_does_not_wait_for_the_audit_of_a_process_that_never_asks_for_work() {
    let (mut table, a, _silent) = episode();
    table.tick(TTL * 4);
    let first = lease(&mut table, a);
    play(&mut table, &first, 1.0).unwrap();
    assert_eq!(returns(&table.effects()), [1.0]);
}

#[test]
fn an_audit_is_skipped_once_all_other_processes_lose_their_work() {
    let (mut table, a, hoarder) = episode();
    let first = lease(&mut table, a);
    table.open_iteration(weights(), works(8, 3));
    (0..3).for_each(|_| drop(lease(&mut table, hoarder)));
    table.tick(TTL - TTL / 10);
    assert!(beat(&mut table, a, &first, 1));
    play(&mut table, &first, 1.0).unwrap();
    table.effects();
    table.tick(TTL);
    assert!(table.effects().iter().any(|effect| matches!(effect, Effect::Evaluation(_))));
    assert_eq!(table.counts().audits, AuditCounts { skipped: 1, ..AuditCounts::default() });
}
