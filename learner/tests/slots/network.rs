//! A simulated cluster with faults: messages are lost, duplicated, delayed and reordered, actors are killed, frozen and
//! restarted, and the learner restarts.

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

use crate::cluster::Cluster;
use crate::events::{ACTORS, MOST_IN_FLIGHT, SimulatedEvent};

/// Random events with their relative frequencies.
fn event() -> impl Strategy<Value = SimulatedEvent> {
    let actor = || 0..ACTORS;
    let message = || prop_oneof![3 => Just(0), 1 => 0..MOST_IN_FLIGHT];
    prop_oneof![
        24 => actor().prop_map(SimulatedEvent::Act),
        4 => actor().prop_map(SimulatedEvent::Heartbeat),
        36 => message().prop_map(SimulatedEvent::Arrive),
        4 => message().prop_map(SimulatedEvent::ArriveTwice),
        2 => message().prop_map(SimulatedEvent::Lose),
        1 => actor().prop_map(SimulatedEvent::Refuse),
        1 => actor().prop_map(SimulatedEvent::Kill),
        1 => actor().prop_map(SimulatedEvent::Freeze),
        2 => actor().prop_map(SimulatedEvent::Thaw),
        2 => actor().prop_map(SimulatedEvent::Join),
        4 => Just(SimulatedEvent::Learn),
        1 => (0..12_u32).prop_map(|once| if once == 0 { SimulatedEvent::Restart } else { SimulatedEvent::Learn }),
        4 => (1..8_u32).prop_map(SimulatedEvent::Pass),
    ]
}

/// The same on every machine, unless `SLOT_CASES_SEED` has another seed. A case that fails becomes a named test.
fn randomness() -> TestRng {
    let Ok(seed) = std::env::var("SLOT_CASES_SEED") else {
        return TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    };
    let seed: u64 = seed.parse().expect("SLOT_CASES_SEED is a number");
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    TestRng::from_seed(RngAlgorithm::ChaCha, &bytes)
}

#[test]
fn a_cluster_on_a_faulty_network_consumes_each_slot_exactly_once_and_makes_progress() {
    let config = Config {
        cases: 400,
        failure_persistence: None,
        fork: false,
        timeout: 0,
        max_shrink_iters: 4096,
        ..Config::default()
    };
    let lists = proptest::collection::vec(event(), 0..600);
    let outcome = TestRunner::new_with_rng(config, randomness()).run(&lists, |events| {
        let mut cluster = Cluster::new();
        events.into_iter().for_each(|event| cluster.apply(event));
        cluster.settle();
        Ok(())
    });
    outcome.unwrap_or_else(|error| panic!("{error}"));
}
