//! Every learning rule, and policies without recurrence, with real processes: neither the number of actors nor a stop
//! changes the result.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::path::Path;
use std::process::Command;

/// 4 environments x 20 steps, two slots, short networks; MADDPG warms up for one iteration.
const TINY: &[&str] = &[
    "halfcheetah-2x3",
    "run.seed=7",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.message_steps=10",
    "critic.width=16",
    "evaluation.every_steps=160",
    "evaluation.episodes=1",
    "checkpoint.every=2",
];

const GRU: &[&str] = &["policy.encoder=8", "policy.hidden=8"];
const MLP: &[&str] = &["policy.width=8", "policy.layers=1"];
const ON_POLICY: &[&str] = &["update.epochs=2", "critic.epochs=2"];
const INFLUENCE: &[&str] = &["influence.encoder=8", "influence.hidden=8", "influence.epochs=2"];
const REPLAY: &[&str] =
    &["maddpg.replay=200", "maddpg.batch=16", "maddpg.n_step=3", "maddpg.warm_up=80"];

/// Settings of a small run with the algorithm and the core of `settings`.
fn small(settings: &[&str]) -> Vec<&'static str> {
    let has = |setting: &str| settings.contains(&setting);
    if has("algorithm=maddpg") {
        return [TINY, MLP, REPLAY].concat();
    }
    let core = if has("policy.core=mlp") { MLP } else { GRU };
    let influence = has("algorithm=happo-s2mia") || has("influence.lambda=0.01");
    [TINY, core, ON_POLICY, if influence { INFLUENCE } else { &[] }].concat()
}

fn succeeded(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_s2mia")).args(arguments).output().unwrap();
    let (out, err) = (String::from_utf8(output.stdout).unwrap(), output.stderr);
    assert!(output.status.success(), "{arguments:?}\n{out}\n{}", String::from_utf8_lossy(&err));
    out
}

fn inspect(folder: &Path) -> serde_json::Value {
    serde_json::from_str(&succeeded(&["inspect", folder.to_str().unwrap(), "--json"])).unwrap()
}

/// Checks that five iterations with two actors end in the same state as three with one actor and a resume.
fn trains_exactly(settings: &[&str]) -> serde_json::Value {
    let runs = tempfile::tempdir().unwrap();
    let train = |name: &str, more: &[&str]| {
        let folder = runs.path().join(name);
        let dir = format!("run.dir={}", folder.display());
        succeeded(&[&["train"], &small(settings)[..], settings, &[dir.as_str()], more].concat());
        folder
    };
    let whole = inspect(&train("whole", &["run.iterations=5", "run.actors=2"]));
    let parts = train("parts", &["run.iterations=3", "run.actors=1"]);
    let resume = ["train", "--resume", parts.to_str().unwrap()];
    succeeded(&[&resume[..], &["run.iterations=5", "run.actors=1"]].concat());
    assert_eq!(whole["iteration"], 5);
    assert_eq!(inspect(&parts), whole, "{settings:?}");
    whole
}

#[test]
fn mappo_trains_the_same_weights_with_any_number_of_actors_and_through_a_stop() {
    let shared = trains_exactly(&["algorithm=mappo"]);
    let separate = trains_exactly(&["algorithm=mappo", "update.parameters=separate"]);
    let both_terms = ["algorithm=mappo", "surprise.alpha=0.01", "influence.lambda=0.01"];
    let with_terms = trains_exactly(&both_terms);
    assert_ne!(shared["weights_sha256"], separate["weights_sha256"]);
    assert_ne!(shared["weights_sha256"], with_terms["weights_sha256"]);
}

#[test]
fn maddpg_trains_the_same_weights_with_any_number_of_actors_and_through_a_stop() {
    trains_exactly(&["algorithm=maddpg"]);
}

#[test]
fn policies_without_recurrence_train_with_every_policy_gradient_rule() {
    trains_exactly(&["algorithm=happo-s2mia", "policy.core=mlp"]);
    trains_exactly(&["algorithm=mappo", "policy.core=mlp"]);
}

#[test]
fn running_statistics_are_the_same_with_any_number_of_actors_and_through_a_stop() {
    let raw = trains_exactly(&["algorithm=happo-s2mia", "observation.norm=none"]);
    let observations = trains_exactly(&["algorithm=happo-s2mia", "observation.norm=running"]);
    let alone = ["algorithm=happo-s2mia", "observation.norm=running", "critic.state_norm=none"];
    let alone = trains_exactly(&alone);
    assert_ne!(observations["weights_sha256"], raw["weights_sha256"]);
    assert_ne!(observations["weights_sha256"], alone["weights_sha256"]);
}

#[test]
fn a_run_that_recomputes_recurrent_states_is_resumed_exactly() {
    let stored = trains_exactly(&["algorithm=happo-s2mia"]);
    let settings = ["algorithm=happo-s2mia", "policy.refresh_hidden=every_epoch"];
    let chunks = ["policy.backpropagation_steps=5", "policy.burn_in=5"];
    let again = trains_exactly(&[settings, chunks].concat());
    assert_ne!(again["weights_sha256"], stored["weights_sha256"]);
}
