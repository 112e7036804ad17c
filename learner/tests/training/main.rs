//! Whole runs without sockets: a toy environment, actors that call the exchange, and the trainer. The result depends
//! only on settings and seed.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod actor;
mod canary;
mod cut;
mod end_states;
mod film;
mod one_slot;
mod settings;
mod toy;

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use learner::error::LearnerError;
use learner::launch;
use learner::launch::Launch;
use learner::lease::exchange::Exchange;
use learner::observe::event::{Event, Summary};
use learner::store::checkpoint::load_newest;
use learner::store::run_folder::RunFolderError;
use learner::train::trainer::Outside;
use serde_json::Value;

use actor::ActorThreads;
use settings::{launch_in, resumed};

/// Trains with `actors` actors; stops after the first event for which `enough` is true.
fn train_until(
    launch: Launch,
    actors: u64,
    enough: impl Fn(&Event) -> bool + Send + 'static,
) -> (Summary, Vec<Event>) {
    let (summary, events) = try_to_train(launch, actors, enough);
    (summary.unwrap(), events)
}

/// The same for a run that may fail.
fn try_to_train(
    launch: Launch,
    actors: u64,
    enough: impl Fn(&Event) -> bool + Send + 'static,
) -> (Result<Summary, LearnerError>, Vec<Event>) {
    let (lease, audit) = (launch.config.lease, launch.config.audit);
    let (trainer, run) = launch::prepare(launch).unwrap();
    let exchange = Exchange::new(run, lease, audit, toy::states());
    let events = Arc::new(Mutex::new(Vec::new()));
    let stops = Arc::new(AtomicUsize::new(0));
    let (observed, stopping) = (Arc::clone(&events), Arc::clone(&stops));
    let observer = Box::new(move |event: &Event| {
        stopping.fetch_add(usize::from(enough(event)), Ordering::Relaxed);
        observed.lock().unwrap().push(event.clone());
    });
    let stop = Box::new(move || stops.load(Ordering::Relaxed) > 0);
    let running =
        trainer.begin(Outside { exchange: Arc::clone(&exchange), observer, stop }).unwrap();
    let actors = ActorThreads::start(0..actors, &exchange);
    let summary = running.train();
    exchange.finish();
    actors.end();
    let events = std::mem::take(&mut *events.lock().unwrap());
    (summary, events)
}

fn train(launch: Launch, actors: u64) -> Summary {
    train_until(launch, actors, |_| false).0
}

fn lines(folder: &Path, name: &str) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Fields that differ between equal runs.
const VARYING_FIELDS: [&str; 8] = [
    "env_steps_per_sec",
    "iteration_secs",
    "rollout_secs",
    "update_secs",
    "density_secs",
    "actors",
    "messages_refused",
    "leases_reissued",
];

/// The metrics without [`VARYING_FIELDS`].
fn reproducible(folder: &Path) -> Vec<Value> {
    let mut lines = lines(folder, "metrics.jsonl");
    for line in &mut lines {
        if line["kind"] == "evaluation" {
            continue;
        }
        let line = line.as_object_mut().unwrap();
        for name in VARYING_FIELDS {
            line.remove(name).unwrap();
        }
    }
    // The position of an evaluation's line depends on timing.
    lines.sort_by_key(|line| (line["kind"].to_string(), line["iteration"].as_u64()));
    lines
}

fn iterations(lines: &[Value], kind: Option<&str>) -> Vec<u64> {
    let wanted = |line: &&Value| kind.is_none_or(|kind| line["kind"] == kind);
    lines.iter().filter(wanted).map(|line| line["iteration"].as_u64().unwrap()).collect()
}

#[test]
fn a_stopped_and_resumed_run_equals_an_undisturbed_one() {
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(launch_in(whole.path(), 5), 2);
    assert!(!undisturbed.stopped_early);
    assert_eq!((undisturbed.iteration, undisturbed.env_steps), (5, 5 * 4 * 8));

    let third = |event: &Event| matches!(event, Event::Iteration(report) if report.iteration == 3);
    let (stopped, _) = train_until(launch_in(parts.path(), 5), 1, third);
    assert!(stopped.stopped_early);
    assert_eq!(stopped.iteration, 3);
    assert_ne!(stopped.state_sha256, undisturbed.state_sha256);
    let ended = train(resumed(launch_in(parts.path(), 5)), 3);
    assert_eq!(ended.weights_sha256, undisturbed.weights_sha256);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    assert_eq!(reproducible(parts.path()), reproducible(whole.path()));
}

#[test]
fn decaying_learning_rates_continue_after_a_resume() {
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let decaying = |folder: &Path| {
        let mut launch = launch_in(folder, 4);
        launch.training.update.learning_rate_decay = marl::LearningRateDecay::Linear;
        launch
    };
    let undisturbed = train(decaying(whole.path()), 2);
    let second = |event: &Event| matches!(event, Event::Iteration(report) if report.iteration == 2);
    train_until(decaying(parts.path()), 1, second);
    assert_eq!(train(resumed(decaying(parts.path())), 2).state_sha256, undisturbed.state_sha256);
    let steady = tempfile::tempdir().unwrap();
    assert_ne!(train(launch_in(steady.path(), 4), 2).weights_sha256, undisturbed.weights_sha256);
}

#[test]
fn a_killed_run_resumes_from_its_last_checkpoint_and_each_iteration_is_recorded_once() {
    let (whole, killed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(launch_in(whole.path(), 5), 2);
    // The files after a crash in iteration 5: the checkpoint of iteration 4, later lines, and no checkpoint of
    // iteration 5.
    train(launch_in(killed.path(), 5), 2);
    std::fs::remove_dir_all(killed.path().join("checkpoints/iter_00000005")).unwrap();
    let ended = train(resumed(launch_in(killed.path(), 5)), 2);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    let metrics = lines(killed.path(), "metrics.jsonl");
    assert_eq!(iterations(&metrics, Some("iteration")), [1, 2, 3, 4, 5]);
    assert_eq!(iterations(&lines(killed.path(), "provenance.jsonl"), None), [1, 2, 3, 4, 5]);
    assert_eq!(reproducible(killed.path()), reproducible(whole.path()));
}

#[test]
fn a_run_with_a_damaged_checkpoint_repeats_iterations_and_ends_in_the_same_state() {
    let (whole, damaged) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(launch_in(whole.path(), 5), 2);
    train(launch_in(damaged.path(), 4), 2);
    let file = damaged.path().join("checkpoints/iter_00000004/weights.safetensors");
    std::fs::write(&file, "damaged").unwrap();
    let ended = train(resumed(launch_in(damaged.path(), 5)), 2);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    assert!(load_newest(damaged.path()).unwrap().skipped.is_empty());
}

#[test]
fn a_checkpoint_that_cannot_be_written_does_not_affect_training_and_is_retried() {
    let (whole, failing) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(launch_in(whole.path(), 4), 2);
    let checkpoints = failing.path().join("checkpoints");
    let block_one = move |event: &Event| {
        match event {
            Event::Iteration(report) if report.iteration == 2 => {
                std::fs::write(&checkpoints, "no folder").unwrap();
            }
            Event::CheckpointFailed { .. } => std::fs::remove_file(&checkpoints).unwrap(),
            _ => {}
        }
        false
    };
    let (ended, _) = train_until(launch_in(failing.path(), 4), 2, block_one);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    let lines = lines(failing.path(), "metrics.jsonl");
    let iterations = lines.iter().filter(|line| line["kind"] == "iteration");
    let failed: Vec<_> = iterations.map(|line| line["checkpoints_failed"].as_f64()).collect();
    assert_eq!(failed, [0.0, 0.0, 1.0, 0.0].map(Some));
    assert!(failing.path().join("checkpoints/iter_00000003").is_dir());
}

#[test]
fn a_run_whose_folder_is_moved_ends_with_an_error_and_writes_nothing_in_its_place() {
    for is_replaced in [false, true] {
        let parent = tempfile::tempdir().unwrap();
        let (folder, moved) = (parent.path().join("run"), parent.path().join("moved"));
        let (from, to) = (folder.clone(), moved.clone());
        let move_after_second = move |event: &Event| {
            if matches!(event, Event::Iteration(report) if report.iteration == 2) {
                std::fs::rename(&from, &to).unwrap();
                // Another folder in its place is not the run's, either.
                is_replaced.then(|| std::fs::create_dir(&from).unwrap());
            }
            false
        };
        let (ended, _) = try_to_train(launch_in(&folder, 5), 2, move_after_second);
        let lost = LearnerError::RunFolder(RunFolderError::Lost { path: folder.clone() });
        assert_eq!(ended.unwrap_err().to_string(), lost.to_string());
        // Only an empty folder can be removed.
        assert_eq!(std::fs::remove_dir(&folder).is_ok(), is_replaced);
        assert!(!folder.exists());
        std::fs::rename(&moved, &folder).unwrap();
        assert_eq!(train(resumed(launch_in(&folder, 5)), 2).iteration, 5);
    }
}

#[test]
fn a_run_without_a_checkpoint_starts_from_the_beginning() {
    let (whole, lost) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(launch_in(whole.path(), 2), 1);
    train(launch_in(lost.path(), 1), 1);
    std::fs::remove_dir_all(lost.path().join("checkpoints")).unwrap();
    let ended = train(resumed(launch_in(lost.path(), 2)), 1);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    let metrics = lines(lost.path(), "metrics.jsonl");
    assert_eq!(iterations(&metrics, Some("iteration")), [1, 2]);
}

#[test]
fn a_run_stopped_before_its_first_iteration_writes_a_checkpoint() {
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(launch_in(whole.path(), 2), 1);
    let (stopped, _) = train_until(launch_in(parts.path(), 2), 0, |_| true);
    assert_eq!((stopped.iteration, stopped.stopped_early), (0, true));
    let ended = train(resumed(launch_in(parts.path(), 2)), 1);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    assert_eq!(reproducible(parts.path()), reproducible(whole.path()));
}

#[test]
fn evaluations_are_reported_once_at_the_start_the_multiples_and_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let (_, events) = train_until(launch_in(folder.path(), 5), 2, |_| false);
    // 32 steps per iteration, an evaluation every 64.
    let metrics = lines(folder.path(), "metrics.jsonl");
    assert_eq!(iterations(&metrics, Some("evaluation")), [0, 2, 4, 5]);
    let evaluation = metrics.iter().find(|line| line["kind"] == "evaluation").unwrap();
    assert_eq!(evaluation["episodes"], 3);
    assert!(evaluation["minimum"].as_f64() <= evaluation["mean"].as_f64());
    assert!(evaluation["mean"].as_f64() <= evaluation["maximum"].as_f64());
    let reported = events.iter().filter(|event| matches!(event, Event::Evaluation(_))).count();
    assert_eq!(reported, 4);
}

#[test]
fn provenance_contains_slots_actors_and_hashes() {
    let folder = tempfile::tempdir().unwrap();
    let summary = train(launch_in(folder.path(), 2), 2);
    let provenance = lines(folder.path(), "provenance.jsonl");
    assert_eq!(provenance[1]["weights_sha256"], summary.weights_sha256);
    assert_eq!(provenance[1]["behaviour"]["version"], 1);
    let slots = provenance[1]["slots"].as_array().unwrap();
    assert_eq!(slots.iter().map(|slot| slot["slot"].as_u64().unwrap()).collect::<Vec<_>>(), [0, 1]);
    // 8 steps in chunks of 4.
    assert!(slots.iter().all(|slot| slot["digests"].as_array().unwrap().len() == 2));
    assert_eq!(provenance[0]["density_sha256"].as_str().unwrap().len(), 64);
    let mut order = provenance[0]["order"].as_array().unwrap().clone();
    order.sort_by_key(Value::as_u64);
    assert_eq!(order, [0, 1]);
}

#[test]
fn a_resume_with_other_settings_or_fewer_iterations_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    train(launch_in(folder.path(), 2), 1);
    let mut other = resumed(launch_in(folder.path(), 3));
    other.config_sha256 = proto::Digest([7; 32]);
    let error = launch::prepare(other).map(drop).unwrap_err();
    assert!(
        matches!(error, LearnerError::RunFolder(RunFolderError::OtherConfig { .. })),
        "{error}"
    );
    let error = launch::prepare(resumed(launch_in(folder.path(), 1))).map(drop).unwrap_err();
    assert!(error.to_string().contains("stands at iteration 2, past the 1"), "{error}");
}
