//! A simulated cluster with faults: messages are lost, duplicated, delayed and reordered, actors are killed, frozen and
//! restarted, and the learner restarts.

use proptest::prelude::*;

use crate::cluster::Cluster;
use crate::events::{ACTORS, MOST_IN_FLIGHT, SimulatedEvent};
use crate::random_cases::for_all;

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
        1 => actor().prop_map(SimulatedEvent::Kill),
        1 => actor().prop_map(SimulatedEvent::Freeze),
        2 => actor().prop_map(SimulatedEvent::Thaw),
        2 => actor().prop_map(SimulatedEvent::Join),
        4 => Just(SimulatedEvent::Learn),
        1 => (0..12_u32).prop_map(|once| if once == 0 { SimulatedEvent::Restart } else { SimulatedEvent::Learn }),
        4 => (1..8_u32).prop_map(SimulatedEvent::Pass),
    ]
}

#[test]
fn a_cluster_on_a_faulty_network_consumes_each_slot_exactly_once_and_makes_progress() {
    for_all(400, &proptest::collection::vec(event(), 0..600), |events| {
        let mut cluster = Cluster::new();
        events.into_iter().for_each(|event| cluster.apply(event));
        cluster.settle();
    });
}
