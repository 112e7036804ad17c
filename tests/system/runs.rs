//! Commands that end by themselves, and small runs.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// Settings of a small run: 4 environments x 20 steps, two slots, small networks.
const TINY: [&str; 17] = [
    "halfcheetah-6x1",
    "run.seed=7",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.message_steps=10",
    "policy.encoder=8",
    "policy.hidden=8",
    "critic.width=16",
    "influence.encoder=8",
    "influence.hidden=8",
    "update.epochs=2",
    "critic.epochs=2",
    "influence.epochs=2",
    "evaluation.every_steps=160",
    "evaluation.episodes=1",
    "checkpoint.every=2",
];

/// MADDPG with a small replay and small networks; two of six iterations only warm up.
pub(crate) const SMALL_MADDPG: [&str; 8] = [
    "algorithm=maddpg",
    "policy.width=8",
    "policy.layers=1",
    "critic.layers=1",
    "maddpg.replay=200",
    "maddpg.batch=16",
    "maddpg.n_step=3",
    "maddpg.warm_up=160",
];

/// HASAC with a small replay and small networks; two of six iterations only warm up.
pub(crate) const SMALL_HASAC: [&str; 9] = [
    "algorithm=hasac",
    "policy.width=8",
    "policy.layers=1",
    "critic.layers=1",
    "hasac.replay=200",
    "hasac.batch=16",
    "hasac.n_step=3",
    "hasac.warm_up=160",
    "hasac.updates_per_step=0.2",
];

/// The length of a run of two iterations without evaluations.
pub(crate) const SHORT: [&str; 2] = ["run.iterations=2", "evaluation.every_steps=0"];

pub(crate) fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(arguments);
    command
}

/// `s2mia train` or `s2mia learner` for a run in `folder`: [`TINY`] without what has no effect with `more`, and `more`.
pub(crate) fn tiny(role: &str, folder: &Path, more: &[&str]) -> Command {
    let has = |setting: &str| more.contains(&setting);
    let mut without = Vec::new();
    if ["algorithm=maddpg", "algorithm=hasac", "algorithm=hasac-sm", "algorithm=hasac-s2mia-exact"]
        .into_iter()
        .any(has)
    {
        without.extend(["policy.", "influence.", "update.epochs", "critic.epochs"]);
    }
    if has("algorithm=mappo") || has("algorithm=happo-s2mia-exact") {
        without.push("influence.");
    }
    if has("policy.core=mlp") {
        without.extend(["policy.encoder", "policy.hidden"]);
    }
    let has_effect = |setting: &&str| !without.iter().any(|key| setting.starts_with(key));
    let mut command = command(&[role]);
    command.args(TINY.into_iter().filter(has_effect));
    command.arg(format!("run.dir={}", folder.display())).args(more);
    command
}

/// `program` with the words of `command` after its own.
pub(crate) fn under(program: &str, own: &[&str], command: &Command) -> Command {
    let mut outer = Command::new(program);
    outer.args(own).arg(command.get_program()).args(command.get_args());
    outer
}

pub(crate) fn s2mia(arguments: &[&str]) -> Output {
    command(arguments).output().unwrap()
}

pub(crate) fn error(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Exit status of an ended process, and its output and error together.
pub(crate) fn outcome(output: Output) -> (Option<i32>, String) {
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(text).unwrap())
}

/// Standard output and standard error of a command that succeeds.
pub(crate) fn success(command: &mut Command) -> (String, String) {
    let output = command.output().unwrap();
    let error = error(&output);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{command:?}\n{text}\n{error}");
    (text, error)
}

pub(crate) fn succeeded(arguments: &[&str]) -> String {
    success(&mut command(arguments)).0
}

/// Standard error of a command that succeeds.
pub(crate) fn warned(arguments: &[&str]) -> String {
    success(&mut command(arguments)).1
}

/// The one line on stderr of a command that ends with `status` and prints nothing else.
pub(crate) fn failure(command: &mut Command, status: i32) -> String {
    let output = command.output().unwrap();
    let line = error(&output);
    assert_eq!(output.status.code(), Some(status), "{command:?}: {line}");
    assert_eq!(line.lines().count(), 1, "{command:?}: {line}");
    assert!(output.stdout.is_empty(), "{command:?}");
    line
}

pub(crate) fn failed(arguments: &[&str], status: i32) -> String {
    failure(&mut command(arguments), status)
}

/// The line with which a command is refused, with status 2.
pub(crate) fn refused(arguments: &[&str]) -> String {
    failed(arguments, 2)
}

pub(crate) fn train(folder: &Path, more: &[&str]) -> String {
    success(&mut tiny("train", folder, more)).0
}

pub(crate) fn inspect(folder: &Path) -> Value {
    serde_json::from_str(&succeeded(&["inspect", text(folder), "--json"])).unwrap()
}

pub(crate) fn weights(folder: &Path) -> Value {
    inspect(folder)["weights_sha256"].clone()
}

/// The status of a run, by its folder or its learner's URL.
pub(crate) fn status(of: &str) -> Value {
    serde_json::from_str(&succeeded(&["status", of, "--json"])).unwrap()
}

/// The result of `s2mia eval`.
pub(crate) fn evaluated(run: &str, more: &[&str]) -> Value {
    let printed = succeeded(&[&["eval", run, "--json"], more].concat());
    serde_json::from_str(&printed).unwrap()
}

/// A file of one JSON value.
pub(crate) fn json(file: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap()
}

/// The whole lines of a run's metrics of this kind, so far.
pub(crate) fn metrics(folder: &Path, kind: &str) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join("metrics.jsonl")).unwrap_or_default();
    let lines = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    lines.filter(|line| line["kind"] == kind).collect()
}

pub(crate) fn words(all: &[String]) -> Vec<&str> {
    all.iter().map(String::as_str).collect()
}

/// A path as an argument.
pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A folder for the runs of a test.
pub(crate) struct Runs(tempfile::TempDir);

impl Runs {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn folder(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}
