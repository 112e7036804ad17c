//! Cases of the model that can be worked out by hand.

use std::time::Duration;

use crate::cluster::Cluster;
use crate::costs::{EQUAL_MACHINES, NO_FAILURES};
use crate::figures::Totals;
use crate::scenario::{
    Calls, Cores, Duplicates, Failures, LeaseTimes, Network, Scenario, SlowMachines,
};

const SLOT: Duration = Duration::from_secs(2);
const UPDATE: Duration = Duration::from_secs(30);
const TTL: Duration = Duration::from_secs(20);
/// What the exchange adds to a deadline.
const MILLISECOND: Duration = Duration::from_millis(1);
const NO_NETWORK: Network =
    Network { latency: Duration::ZERO, chunk: Duration::ZERO, weights: Duration::ZERO };

/// Equal machines without failures; nothing but steps and updates takes time. A slot has two chunks of a second each.
fn ideal(actors: usize, slots: u32) -> Scenario {
    Scenario {
        seed: 1,
        actors,
        leases: 2,
        slots,
        chunks: 2,
        step: SLOT / 2,
        update: UPDATE,
        cores: Cores::Own(1),
        check: Duration::ZERO,
        calls: Calls { request: Duration::ZERO, other: Duration::ZERO },
        network: NO_NETWORK,
        lease: LeaseTimes { ttl: TTL, heartbeat: Duration::from_secs(5) },
        duplicates: Duplicates::BackupsAndAudits(0.0),
        slow: EQUAL_MACHINES,
        failures: NO_FAILURES,
    }
}

/// What happens in four iterations after the first.
fn four(scenario: Scenario) -> Totals {
    let mut cluster = Cluster::new(scenario);
    cluster.run(1);
    cluster.run(4)
}

/// Duration of a later iteration; all are equal.
fn iteration(scenario: Scenario) -> Duration {
    let totals = four(scenario);
    assert_eq!(totals.slots, 4 * u64::from(totals.slots as u32 / 4));
    totals.elapsed / 4
}

#[test]
fn one_actor_takes_the_sum_of_the_slots_and_the_update() {
    assert_eq!(iteration(ideal(1, 5)), 5 * SLOT + UPDATE);
    let totals = four(ideal(1, 5));
    assert_eq!((totals.busy, totals.rollouts), (20 * SLOT, 20 * SLOT));
}

#[test]
fn equal_actors_share_the_slots_evenly() {
    for (actors, rounds) in [(2, 5), (3, 4), (4, 3), (5, 2), (10, 1), (25, 1)] {
        assert_eq!(iteration(ideal(actors, 10)), rounds * SLOT + UPDATE, "{actors} actors");
    }
}

#[test]
fn as_many_actors_as_slots_take_the_longest_slot_and_the_update() {
    let slow = SlowMachines { share: 0.25, factor: 2 };
    assert_eq!(iteration(Scenario { slow, ..ideal(4, 4) }), 2 * SLOT + UPDATE);
}

#[test]
fn actors_beyond_the_slots_are_idle() {
    let totals = four(ideal(20, 10));
    let stepping = 0.5 * SLOT.as_secs_f64() / (SLOT + UPDATE).as_secs_f64();
    assert!((totals.idle_share(20) - (1.0 - stepping)).abs() < 1e-9);
}

#[test]
fn a_slot_of_a_failed_machine_is_computed_again_after_its_time_to_live() {
    for (failure, last_message) in [(0.5, 0), (1.5, 1)] {
        let failures = Failures { silent: 2 * TTL, away: 10 * TTL, ..NO_FAILURES };
        let duplicates = Duplicates::No;
        let mut cluster = Cluster::new(Scenario { failures, duplicates, ..ideal(2, 1) });
        cluster.fail_at(Duration::from_secs_f64(failure), 0);
        let totals = cluster.run(1);
        let expired = Duration::from_secs(last_message) + TTL + MILLISECOND;
        assert_eq!(totals.rollouts, expired + SLOT, "failed at {failure}");
        assert_eq!((totals.reissued, totals.failures), (1, 1));
    }
}

#[test]
fn a_failed_machine_asks_for_nothing_although_a_message_to_it_is_on_its_way() {
    let network = Network { latency: MILLISECOND, ..NO_NETWORK };
    let failures = Failures { silent: Duration::ZERO, away: 10 * TTL, ..NO_FAILURES };
    let mut cluster = Cluster::new(Scenario { failures, network, leases: 1, ..ideal(2, 2) });
    // The learner acknowledged its last chunk half a millisecond ago.
    cluster.fail_at(5 * MILLISECOND + SLOT + MILLISECOND / 2, 0);
    let totals = cluster.run(2);
    assert_eq!((totals.slots, totals.reissued), (4, 0));
}

#[test]
fn a_slot_is_free_at_once_if_the_connection_closes() {
    let mut cluster = Cluster::new(Scenario {
        failures: Failures { silent: Duration::ZERO, away: 10 * TTL, ..NO_FAILURES },
        ..ideal(2, 1)
    });
    cluster.fail_at(Duration::from_secs_f64(0.5), 0);
    assert_eq!(cluster.run(1).rollouts, Duration::from_secs_f64(0.5) + SLOT);
}

/// A machine of four is ten times slower than the others.
fn one_slow(duplicates: Duplicates) -> Scenario {
    let slow = SlowMachines { share: 0.25, factor: 10 };
    Scenario { slow, duplicates, ..ideal(4, 4) }
}

#[test]
fn without_a_backup_a_slow_machine_costs_ten_slots() {
    assert_eq!(iteration(one_slow(Duplicates::No)), 10 * SLOT + UPDATE);
}

#[test]
fn with_a_backup_a_slow_machine_costs_three_slots_of_waiting_and_one_of_work() {
    let totals = four(one_slow(Duplicates::BackupsAndAudits(0.0)));
    assert_eq!(totals.rollouts, 4 * (4 * SLOT + MILLISECOND));
    assert_eq!((totals.backups, totals.slots), (4, 16));
}

#[test]
fn audits_and_slow_updates_do_not_delay_each_other() {
    let audited = Scenario { duplicates: Duplicates::BackupsAndAudits(1.0), ..ideal(4, 4) };
    let totals = four(audited);
    assert_eq!(totals.elapsed, 4 * (SLOT + UPDATE));
    assert_eq!(totals.busy, 2 * 16 * SLOT, "each slot is computed twice");
}

#[test]
fn latency_is_paid_by_each_lease_and_by_the_weights() {
    let latency = Duration::from_millis(10);
    let network = Network { latency, ..NO_NETWORK };
    // Answer, request and weights; then a request and an answer between two slots; last the last chunk.
    let messages = 3 + 4 * 2 + 1;
    let scenario = Scenario { network, ..ideal(1, 5) };
    assert_eq!(iteration(scenario), 5 * SLOT + messages * latency + UPDATE);
}

#[test]
fn one_lease_at_a_time_waits_for_the_acknowledgement() {
    let latency = Duration::from_millis(10);
    let network = Network { latency, ..NO_NETWORK };
    // Chunk and acknowledgement come before the request.
    let messages = 3 + 4 * 4 + 1;
    let scenario = Scenario { network, leases: 1, ..ideal(1, 5) };
    assert_eq!(iteration(scenario), 5 * SLOT + messages * latency + UPDATE);
}

#[test]
fn weights_leave_the_learner_one_after_the_other() {
    let weights = Duration::from_secs(1);
    let network = Network { weights, ..NO_NETWORK };
    assert_eq!(iteration(Scenario { network, ..ideal(3, 3) }), 3 * weights + SLOT + UPDATE);
}

#[test]
fn chunks_that_come_together_are_checked_one_after_the_other_by_each_core() {
    let check = Duration::from_millis(900);
    for (cores, each) in [(1, 6), (2, 3), (3, 2), (6, 1)] {
        let scenario = Scenario { check, cores: Cores::Own(cores), chunks: 1, ..ideal(6, 6) };
        let scenario = Scenario { step: SLOT, ..scenario };
        assert_eq!(iteration(scenario), SLOT + each * check + UPDATE, "{cores} cores");
    }
}

#[test]
fn calls_hold_the_lock_one_after_the_other() {
    let calls = Calls { request: 300 * MILLISECOND, other: 50 * MILLISECOND };
    let locked = |actors: usize| {
        let scenario = Scenario { calls, chunks: 1, step: SLOT, ..ideal(actors, actors as u32) };
        iteration(scenario) - SLOT - UPDATE
    };
    // The first request gets the slot, and the second one comes before the chunk.
    assert_eq!(locked(1), 2 * calls.request + 2 * calls.other);
    // Two chunks, and in between the request of the second actor.
    assert_eq!(locked(2), 3 * calls.request + 4 * calls.other);
}

#[test]
fn actors_and_learner_that_share_cores_take_the_sum_of_their_work() {
    let shared = |actors| {
        let check = Duration::from_secs(1);
        Scenario { cores: Cores::Shared(2), check, chunks: 1, step: SLOT, ..ideal(actors, 8) }
    };
    assert_eq!(iteration(shared(8)), 8 * (SLOT + Duration::from_secs(1)) / 2 + UPDATE);
    assert!(iteration(shared(1)) > iteration(shared(8)));
}

/// Everything that can happen.
fn disturbed(seed: u64) -> Scenario {
    let failures = Failures {
        every: Some(Duration::from_secs(300)),
        away: Duration::from_secs(60),
        silent: Duration::from_secs(30),
    };
    let slow = SlowMachines { share: 0.1, factor: 5 };
    let duplicates = Duplicates::BackupsAndAudits(0.1);
    let network =
        Network { latency: Duration::from_millis(3), chunk: MILLISECOND, weights: MILLISECOND };
    Scenario { seed, failures, slow, duplicates, network, check: MILLISECOND, ..ideal(30, 50) }
}

#[test]
fn each_slot_is_complete_once_in_each_iteration_whatever_happens() {
    for duplicates in [Duplicates::No, Duplicates::BackupsAndAudits(0.1)] {
        let totals = Cluster::new(Scenario { duplicates, ..disturbed(3) }).run(100);
        assert_eq!(totals.slots, 100 * 50);
        let again = totals.reissued + totals.backups;
        assert!(totals.failures > 100 && again > 10, "{totals:?}");
    }
}

#[test]
fn a_simulation_depends_on_nothing_but_its_scenario() {
    let run = |seed| Cluster::new(disturbed(seed)).run(50);
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
}

#[test]
fn machines_fail_as_often_as_they_should() {
    let every = Duration::from_secs(100);
    let failures = Failures { every: Some(every), away: Duration::ZERO, silent: Duration::ZERO };
    let totals = Cluster::new(Scenario { failures, ..ideal(100, 100) }).run(100);
    let expected = 100.0 * totals.elapsed.as_secs_f64() / every.as_secs_f64();
    assert!((totals.failures as f64 / expected - 1.0).abs() < 0.1, "{totals:?}");
}

#[test]
fn slow_machines_are_spread_evenly() {
    let slow = SlowMachines { share: 0.05, factor: 3 };
    let indices: Vec<usize> = (0..60).filter(|&index| slow.contain(index)).collect();
    assert_eq!(indices, [9, 29, 49]);
}
