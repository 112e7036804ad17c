//! How environments are cut into slots depends on the connected actor threads, and no result depends on it.

use std::path::Path;
use std::sync::{Arc, Mutex};

use learner::launch::Launch;
use learner::lease::exchange::Exchange;
use learner::observe::event::Event;
use learner::train::prepare::prepare;
use learner::train::trainer::Outside;

use crate::actor::ActorThreads;
use crate::settings::launch_in;
use crate::{lines, train};

/// A run of 30 environments.
fn launch_of(folder: &Path, iterations: u64, per_slot: usize) -> Launch {
    let mut launch = launch_in(folder, iterations);
    launch.config.environments.count = 30;
    launch.config.environments.per_slot = per_slot;
    launch
}

/// Slots of each iteration, and environments of its first slot.
fn cuts(folder: &Path) -> Vec<(usize, u64)> {
    let cut = |line: &serde_json::Value| {
        let slots = line["slots"].as_array().unwrap();
        (slots.len(), slots[0]["environments"].as_u64().unwrap())
    };
    lines(folder, "provenance.jsonl").iter().map(cut).collect()
}

#[test]
fn threads_that_join_later_get_slots_from_the_next_iteration_on_and_change_no_result() {
    let (alone, joined) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let expected = train(launch_of(alone.path(), 5, 3), 1);
    assert_eq!(cuts(alone.path()), [(10, 3); 5]);
    let launch = launch_of(joined.path(), 5, 0);
    let (lease, audit) = (launch.config.lease, launch.config.audit);
    let (trainer, run) = prepare(launch).unwrap();
    let exchange = Exchange::new(run, lease, audit, crate::hopper::states());
    let actors = Arc::new(Mutex::new(Vec::new()));
    let (join, all) = (Arc::clone(&exchange), Arc::clone(&actors));
    let observer = Box::new(move |event: &Event| {
        if matches!(event, Event::Iteration(report) if report.iteration == 2) {
            all.lock().unwrap().push(ActorThreads::start(1..8, &join));
            while join.threads() < 8 {
                std::thread::yield_now();
            }
        }
    });
    let outside = Outside { exchange: Arc::clone(&exchange), observer, stop: Box::new(|| false) };
    let running = trainer.begin(outside).unwrap();
    actors.lock().unwrap().push(ActorThreads::start(0..1, &exchange));
    let summary = running.train().unwrap();
    exchange.finish();
    std::mem::take(&mut *actors.lock().unwrap()).into_iter().for_each(ActorThreads::end);
    // No actor is connected when the first iteration opens; then one thread is, then eight.
    assert_eq!(cuts(joined.path()), [(30, 1), (3, 10), (3, 10), (30, 1), (30, 1)]);
    assert_eq!(summary.state_sha256, expected.state_sha256);
}
