//! Runs whose iterations are rolled out beside the update before them.

use std::path::Path;

use learner::{Event, Launch};
use marl::ObservationScale;
use serde_json::Value;

use crate::settings::{launch_in, resumed};
use crate::{lines, timeless, train, train_until};

/// Environment steps of an iteration.
const STEPS: u64 = 4 * 8;

/// One update behind, with statistics of observations that are, too.
fn overlapping(folder: &Path, iterations: u64) -> Launch {
    let mut launch = launch_in(folder, iterations);
    launch.training.behaviour.policy_lag = 1;
    launch.observations = ObservationScale::Running;
    launch
}

#[test]
fn an_iteration_is_rolled_out_with_the_weights_before_the_newest_from_before_their_update_ends() {
    let folder = tempfile::tempdir().unwrap();
    let (_, events) = train_until(overlapping(folder.path(), 4), 2, |_| false);
    let provenance = lines(folder.path(), "provenance.jsonl");
    let versions: Vec<&Value> =
        provenance.iter().map(|line| &line["behaviour"]["version"]).collect();
    assert_eq!(versions, [0, 0, 1, 2]);
    let metrics = lines(folder.path(), "metrics.jsonl");
    let iterations = metrics.iter().filter(|line| line["kind"] == "iteration");
    let lags: Vec<&Value> = iterations.map(|line| &line["policy_lag"]).collect();
    assert_eq!(lags, [0.0, 1.0, 1.0, 1.0]);
    // Iterations finished when each was opened: its own number waits for the update before it.
    let opened = |k: u64| {
        events.iter().find_map(|event| match event {
            Event::Collecting { iteration, env_steps } if *env_steps == k * STEPS => {
                Some(*iteration)
            }
            _ => None,
        })
    };
    assert_eq!([0, 1, 2, 3].map(opened), [Some(0), Some(0), Some(1), Some(2)]);
}

#[test]
fn whoever_computes_and_wherever_it_is_stopped_the_state_is_the_same() {
    let whole = tempfile::tempdir().unwrap();
    let mut launch = overlapping(whole.path(), 5);
    launch.config.learner.threads = 1;
    let undisturbed = train(launch, 1);
    for finished in 0..5 {
        let parts = tempfile::tempdir().unwrap();
        let reached = move |event: &Event| match event {
            Event::Iteration(report) => report.iteration == finished,
            _ => finished == 0,
        };
        let (stopped, _) = train_until(overlapping(parts.path(), 5), 2 * finished.min(1), reached);
        assert_eq!((stopped.iteration, stopped.stopped_early), (finished, true));
        let ended = train(resumed(overlapping(parts.path(), 5)), 3);
        assert_eq!(ended.state_sha256, undisturbed.state_sha256, "stopped after {finished}");
        assert_eq!(timeless(parts.path()), timeless(whole.path()), "stopped after {finished}");
    }
}

#[test]
fn a_run_that_ended_goes_on_as_one_that_was_longer_from_the_start() {
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(overlapping(whole.path(), 4), 2);
    train(overlapping(parts.path(), 2), 2);
    let ended = train(resumed(overlapping(parts.path(), 4)), 2);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    let synchronous = tempfile::tempdir().unwrap();
    assert_ne!(train(launch_in(synchronous.path(), 4), 2).weights_sha256, ended.weights_sha256);
}
