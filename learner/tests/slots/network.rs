//! A whole cluster on a hostile network: messages are lost, doubled, late and out of order, actors die,
//! freeze and come back, the learner restarts.

use proptest::prelude::*;

use crate::cluster::Cluster;
use crate::disturbances::{Event, MOST_UNDER_WAY, SEATS};
use crate::schedules::for_all;

/// What happens, and how often.
fn event() -> impl Strategy<Value = Event> {
    let seat = || 0..SEATS;
    let message = || prop_oneof![3 => Just(0), 1 => 0..MOST_UNDER_WAY];
    prop_oneof![
        24 => seat().prop_map(Event::Act),
        4 => seat().prop_map(Event::Heartbeat),
        36 => message().prop_map(Event::Arrive),
        4 => message().prop_map(Event::ArriveTwice),
        2 => message().prop_map(Event::Lose),
        1 => seat().prop_map(Event::Kill),
        1 => seat().prop_map(Event::Freeze),
        2 => seat().prop_map(Event::Thaw),
        2 => seat().prop_map(Event::Join),
        4 => Just(Event::Learn),
        1 => (0..12_u32).prop_map(|once| if once == 0 { Event::Restart } else { Event::Learn }),
        4 => (1..8_u32).prop_map(Event::Pass),
    ]
}

#[test]
fn a_cluster_on_a_hostile_network_consumes_each_slot_exactly_once_and_never_stands_still() {
    for_all(400, &proptest::collection::vec(event(), 0..600), |events| {
        let mut cluster = Cluster::new();
        events.into_iter().for_each(|event| cluster.happen(event));
        cluster.settle();
    });
}
