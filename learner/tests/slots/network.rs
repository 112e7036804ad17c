//! A simulated cluster with faults: messages are lost, duplicated, delayed and reordered, actors are killed, frozen and
//! restarted, and the learner restarts.

use proptest::prelude::*;

use crate::cluster::Cluster;
use crate::events::{ACTORS, Event, MOST_IN_FLIGHT};
use crate::random_cases::for_all;

/// Random events with their relative frequencies.
fn event() -> impl Strategy<Value = Event> {
    let actor = || 0..ACTORS;
    let message = || prop_oneof![3 => Just(0), 1 => 0..MOST_IN_FLIGHT];
    prop_oneof![
        24 => actor().prop_map(Event::Act),
        4 => actor().prop_map(Event::Heartbeat),
        36 => message().prop_map(Event::Arrive),
        4 => message().prop_map(Event::ArriveTwice),
        2 => message().prop_map(Event::Lose),
        1 => actor().prop_map(Event::Kill),
        1 => actor().prop_map(Event::Freeze),
        2 => actor().prop_map(Event::Thaw),
        2 => actor().prop_map(Event::Join),
        4 => Just(Event::Learn),
        1 => (0..12_u32).prop_map(|once| if once == 0 { Event::Restart } else { Event::Learn }),
        4 => (1..8_u32).prop_map(Event::Pass),
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
