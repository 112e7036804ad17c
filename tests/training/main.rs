//! Whole runs without sockets: actors that step a hopper and call the exchange, and the trainer. The result depends
//! only on settings and seed.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod actor;
mod canary;
mod cut;
mod end_states;
mod film;
#[expect(dead_code, reason = "the tests of rollouts also need policies")]
#[path = "../../rollout/tests/rollout/fixture.rs"]
mod fixture;
mod hopper;
mod one_slot;
mod settings;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use learner::error::LearnerError;
use learner::launch::Launch;
use learner::lease::exchange::Exchange;
use learner::observe::event::{Event, INCIDENTAL, Summary};
use learner::store::checkpoint::load_newest;
use learner::store::run_folder::RunFolderError;
use learner::train::prepare::prepare;
use learner::train::trainer::Outside;
use marl::LearningRateDecay;
use marl::config::Estimator;
use policy::Noise;
use proto::Digest;
use serde_json::Value;

use actor::ActorThreads;
use settings::{launch_in, resumed};

/// Trains with `actors` actors; stops after the first event for which `enough` is true.
fn train_until(
    launch: Launch,
    actors: u64,
    enough: impl Fn(&Event) -> bool + Send + 'static,
) -> Result<Summary, LearnerError> {
    let (lease, audit) = (launch.config.lease, launch.config.audit);
    let (trainer, run) = prepare(launch).unwrap();
    let exchange = Exchange::new(run, lease, audit, hopper::states());
    let stopping = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stopping);
    let observer = Box::new(move |event: &Event| {
        stopping.fetch_or(enough(event), Ordering::Relaxed);
    });
    let stop = Box::new(move || stopped.load(Ordering::Relaxed));
    let running =
        trainer.begin(Outside { exchange: Arc::clone(&exchange), observer, stop }).unwrap();
    let actors = ActorThreads::start(0..actors, &exchange);
    let summary = running.train();
    exchange.finish();
    actors.end();
    summary
}

fn train(launch: Launch, actors: u64) -> Summary {
    train_until(launch, actors, |_| false).unwrap()
}

fn lines(folder: &Path, name: &str) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The metrics without [`INCIDENTAL`].
fn reproducible(folder: &Path) -> Vec<Value> {
    let mut lines = lines(folder, "metrics.jsonl");
    for line in &mut lines {
        if line["kind"] == "evaluation" {
            continue;
        }
        let line = line.as_object_mut().unwrap();
        for name in INCIDENTAL {
            line.remove(name);
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

fn decaying(folder: &Path) -> Launch {
    let mut launch = launch_in(folder, 5);
    launch.training.update.learning_rate_decay = LearningRateDecay::Linear;
    launch
}

#[test]
fn a_resumed_run_equals_an_undisturbed_one_whatever_interrupted_it() {
    let whole = tempfile::tempdir().unwrap();
    let undisturbed = train(decaying(whole.path()), 2);
    assert!(!undisturbed.stopped_early);
    assert_eq!((undisturbed.iteration, undisturbed.env_steps), (5, 5 * 4 * 8));
    type Damage = fn(&Path);
    // Actors, the iteration after which the run stops (6: it ends), and what is done to its folder.
    let interruptions: [(&str, u64, u64, Damage); 5] = [
        ("a stop before the first iteration", 0, 0, |_| {}),
        ("a stop between two checkpoints", 1, 3, |_| {}),
        ("a crash after the lines of iteration 5 and before its checkpoint", 2, 6, |run| {
            std::fs::remove_dir_all(run.join("checkpoints/iter_00000005")).unwrap();
        }),
        ("a damaged checkpoint", 2, 4, |run| {
            let file = run.join("checkpoints/iter_00000004/weights.safetensors");
            std::fs::write(file, "damaged").unwrap();
        }),
        ("a crash before the first checkpoint", 1, 1, |run| {
            std::fs::remove_dir_all(run.join("checkpoints")).unwrap();
        }),
    ];
    for (name, actors, last, damage) in interruptions {
        let folder = tempfile::tempdir().unwrap();
        let stopped = train_until(decaying(folder.path()), actors, move |event| match event {
            Event::Iteration(report) => report.iteration == last,
            _ => last == 0,
        });
        let stopped = stopped.unwrap();
        assert_eq!((stopped.iteration, stopped.stopped_early), (last.min(5), last < 6), "{name}");
        damage(folder.path());
        let ended = train(resumed(decaying(folder.path())), 3);
        assert_eq!(ended.state_sha256, undisturbed.state_sha256, "{name}");
        assert_eq!(reproducible(folder.path()), reproducible(whole.path()), "{name}");
        let provenance = lines(folder.path(), "provenance.jsonl");
        assert_eq!(iterations(&provenance, None), [1, 2, 3, 4, 5], "{name}");
        assert!(load_newest(folder.path()).unwrap().skipped.is_empty(), "{name}");
    }
    let steady = tempfile::tempdir().unwrap();
    assert_ne!(train(launch_in(steady.path(), 5), 2).weights_sha256, undisturbed.weights_sha256);
}

/// Agents that share noise, with exact influence. Loadings decrease to 0 in the first three of four iterations.
fn sharing_noise(folder: &Path) -> Launch {
    let mut launch = launch_in(folder, 4);
    (launch.policy.noise, launch.policy.noise_hold) = (Some(Noise::Shared), Some(3));
    launch.policy.noise_decay_steps = Some(3 * 4 * 8);
    launch.training.influence.estimator = Estimator::Exact;
    launch
}

#[test]
fn agents_that_share_noise_learn_the_same_with_one_and_three_actors_and_after_a_resume() {
    let whole = tempfile::tempdir().unwrap();
    let undisturbed = train(sharing_noise(whole.path()), 1);
    let folder = tempfile::tempdir().unwrap();
    let second = |event: &Event| matches!(event, Event::Iteration(report) if report.iteration == 2);
    assert!(train_until(sharing_noise(folder.path()), 3, second).unwrap().stopped_early);
    let ended = train(resumed(sharing_noise(folder.path())), 3);
    assert_eq!(ended.state_sha256, undisturbed.state_sha256);
    assert_eq!(reproducible(folder.path()), reproducible(whole.path()));
    let metrics = lines(whole.path(), "metrics.jsonl");
    let first = metrics.iter().find(|line| line["kind"] == "iteration").unwrap();
    assert!(first["agent0/mi_estimate"].as_f64() > Some(0.0), "{first}");
    assert!(first["agent1/noise_loading"].as_f64() > Some(0.0), "{first}");
    let last = metrics.iter().rfind(|line| line["kind"] == "iteration").unwrap();
    assert_eq!([&last["agent0/mi_estimate"], &last["agent1/noise_loading"]], [0.0, 0.0]);
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
        let ended = train_until(launch_in(&folder, 5), 2, move_after_second);
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
fn evaluations_are_reported_once_at_the_start_the_multiples_and_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let reported = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&reported);
    let count = move |event: &Event| {
        counted.fetch_add(usize::from(matches!(event, Event::Evaluation(_))), Ordering::Relaxed);
        false
    };
    train_until(launch_in(folder.path(), 5), 2, count).unwrap();
    assert_eq!(reported.load(Ordering::Relaxed), 4);
    // 32 steps per iteration, an evaluation every 64.
    let metrics = lines(folder.path(), "metrics.jsonl");
    assert_eq!(iterations(&metrics, Some("evaluation")), [0, 2, 4, 5]);
    let evaluation = metrics.iter().find(|line| line["kind"] == "evaluation").unwrap();
    assert_eq!(evaluation["episodes"], 3);
    assert!(evaluation["minimum"].as_f64() <= evaluation["mean"].as_f64());
    assert!(evaluation["mean"].as_f64() <= evaluation["maximum"].as_f64());
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
fn a_resume_with_fewer_iterations_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    train(launch_in(folder.path(), 2), 1);
    let error = prepare(resumed(launch_in(folder.path(), 1))).map(drop).unwrap_err();
    assert!(error.to_string().contains("stands at iteration 2, past the 1"), "{error}");
}

#[test]
fn a_run_whose_newest_checkpoint_is_of_a_newer_program_or_of_another_run_is_not_resumed() {
    let [folder, other] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    train(launch_in(folder.path(), 1), 1);
    train(resumed(launch_in(folder.path(), 2)), 1);
    let refusal = || {
        let resume = prepare(resumed(launch_in(folder.path(), 4)));
        resume.map(drop).unwrap_err().to_string()
    };
    let newest = folder.path().join("checkpoints/iter_00000002");
    let manifest = newest.join("manifest.json");
    let own = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, own.replace("\"schema\": 2", "\"schema\": 3")).unwrap();
    let error = refusal();
    assert!(error.contains("iter_00000002: manifest.json has schema 3"), "{error}");
    assert!(error.ends_with("use the newer program, or move the checkpoint out of the folder"));
    let mut foreign = launch_in(other.path(), 2);
    foreign.config_sha256 = Digest([9; 32]);
    train(foreign, 1);
    std::fs::remove_dir_all(&newest).unwrap();
    std::fs::rename(other.path().join("checkpoints/iter_00000002"), &newest).unwrap();
    let error = refusal();
    assert!(error.contains("has other settings than this run: its config is 0909"), "{error}");
}

#[test]
fn a_policy_that_diverges_ends_the_run_with_its_agent_iteration_and_learning_rate() {
    for (rate, why) in [(1e6, "its output is "), (1e300, "has a value that is not finite")] {
        let folder = tempfile::tempdir().unwrap();
        let mut launch = launch_in(folder.path(), 5);
        launch.training.update.learning_rate = rate;
        let line = train_until(launch, 2, |_| false).unwrap_err().to_string();
        assert!(line.starts_with("the policy of agent "), "{line}");
        assert!(
            line.contains(" diverged in the update of iteration ") && line.contains(why),
            "{line}"
        );
        let remedy = format!("start a new run with update.learning_rate below {rate:?}; ");
        assert!(line.contains(&remedy), "{line}");
    }
}
