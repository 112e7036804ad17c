//! Whole runs with real processes: the result does not depend on how many actors there are or on stops,
//! and every tool reads what a run leaves.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A run small enough for a test: 4 environments x 20 steps, two slots, short networks.
const TINY: &[&str] = &[
    "halfcheetah-6x1",
    "run.seed=7",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.chunk_steps=10",
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

fn s2mia(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_s2mia")).args(arguments).output().unwrap()
}

fn succeeded(arguments: &[&str]) -> String {
    let output = s2mia(arguments);
    let (out, err) = (String::from_utf8(output.stdout).unwrap(), output.stderr);
    assert!(output.status.success(), "{arguments:?}\n{out}\n{}", String::from_utf8_lossy(&err));
    out
}

fn train(folder: &Path, more: &[&str]) -> String {
    let dir = format!("run.dir={}", folder.display());
    succeeded(&[&["train"], TINY, &[dir.as_str()], more].concat())
}

fn inspect(folder: &Path) -> serde_json::Value {
    serde_json::from_str(&succeeded(&["inspect", folder.to_str().unwrap(), "--json"])).unwrap()
}

struct Runs(tempfile::TempDir);

impl Runs {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn folder(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

#[test]
fn one_actor_and_two_actors_train_the_same_weights() {
    let runs = Runs::new();
    let (one, two) = (runs.folder("one"), runs.folder("two"));
    train(&one, &["run.iterations=5", "run.actors=1"]);
    train(&two, &["run.iterations=5", "run.actors=2"]);
    let (one, two) = (inspect(&one), inspect(&two));
    assert_eq!(one["iteration"], 5);
    assert_eq!(one["env_steps"], 5 * 4 * 20);
    assert_eq!(one, two);
}

/// The whole of a game's training, from its task file, in less time than a robot's first steps.
fn train_cue(folder: &Path, more: &[&str]) -> String {
    let dir = format!("run.dir={}", folder.display());
    succeeded(&[&["train", "cue-2x1", "run.seed=3", dir.as_str()], more].concat())
}

#[test]
fn one_actor_and_two_actors_train_the_same_choices() {
    let runs = Runs::new();
    let (one, two) = (runs.folder("one"), runs.folder("two"));
    train_cue(&one, &["run.iterations=6", "run.actors=1"]);
    train_cue(&two, &["run.iterations=3", "run.actors=2"]);
    succeeded(&["train", "--resume", two.to_str().unwrap(), "run.iterations=6"]);
    let (one, two) = (inspect(&one), inspect(&two));
    assert_eq!(one["env_steps"], 6 * 20 * 50);
    assert_eq!(one, two);
}

#[test]
fn a_cue_that_both_see_is_learnt_by_either_algorithm() {
    for algorithm in ["algorithm=happo", "algorithm=happo-s2mia"] {
        let runs = Runs::new();
        let folder = runs.folder("run");
        train_cue(&folder, &[algorithm, "run.env_steps=30000", "run.actors=2"]);
        let run = folder.to_str().unwrap();
        let measured = succeeded(&["eval", run, "--episodes", "4", "--json"]);
        let measured: serde_json::Value = serde_json::from_str(&measured).unwrap();
        // Guessing earns 50 / 9; matching every cue 50.
        assert!(measured["return_mean"].as_f64().unwrap() > 45.0, "{algorithm}: {measured}");
        succeeded(&["record", run, "--out", folder.join("game.mcap").to_str().unwrap()]);
    }
}

#[test]
fn stopping_and_resuming_changes_nothing() {
    let runs = Runs::new();
    let (whole, parts) = (runs.folder("whole"), runs.folder("parts"));
    train(&whole, &["run.iterations=5", "run.actors=2"]);
    train(&parts, &["run.iterations=3", "run.actors=1"]);
    let parts = parts.to_str().unwrap();
    succeeded(&["train", "--resume", parts, "run.iterations=5", "run.actors=2"]);
    assert_eq!(inspect(Path::new(parts)), inspect(&whole));
}

#[test]
fn a_resume_refuses_what_would_make_it_another_run() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=1", "run.actors=1"]);
    let folder = folder.to_str().unwrap();
    for (setting, key) in [
        ("update.clip=0.3", "`update.clip`"),
        ("algorithm=happo", "`algorithm`"),
        ("run.seed=8", "`run.seed`"),
    ] {
        let output = s2mia(&["train", "--resume", folder, setting]);
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{line}");
        assert!(line.contains(key) && line.contains("cannot change on resume"), "{line}");
    }
    let again = s2mia(&[&["train"], TINY, &[format!("run.dir={folder}").as_str()]].concat());
    assert_eq!(again.status.code(), Some(2));
    assert!(String::from_utf8(again.stderr).unwrap().contains("--resume"));
}

#[test]
fn a_signal_leaves_a_checkpoint_and_status_zero() {
    let runs = Runs::new();
    let (stopped, whole) = (runs.folder("stopped"), runs.folder("whole"));
    let dir = format!("run.dir={}", stopped.display());
    let arguments =
        [&["train"], TINY, &[dir.as_str(), "run.iterations=6", "run.actors=1"]].concat();
    let mut child = Command::new(env!("CARGO_BIN_EXE_s2mia"))
        .args(arguments)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    // The second line comes after the first iteration or evaluation: the run is under way.
    lines.by_ref().take(2).for_each(|line| drop(line.unwrap()));
    let terminated = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(terminated.success());
    let rest: Vec<String> = lines.map(Result::unwrap).collect();
    assert!(child.wait().unwrap().success(), "{rest:?}");
    assert!(rest.iter().any(|line| line.starts_with("checkpoint: ")), "{rest:?}");
    succeeded(&["train", "--resume", stopped.to_str().unwrap()]);
    train(&whole, &["run.iterations=6", "run.actors=2"]);
    assert_eq!(inspect(&stopped), inspect(&whole));
}

#[test]
fn every_tool_reads_what_a_run_leaves() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let told = train(&folder, &["run.iterations=4", "run.actors=2"]);
    assert!(told.contains("algorithm happo-s2mia, seed 7, 2 actors"), "{told}");
    assert!(told.contains("evaluation return"), "{told}");
    let run = folder.to_str().unwrap();

    let measured = succeeded(&["eval", run, "--episodes", "2", "--json"]);
    let measured: serde_json::Value = serde_json::from_str(&measured).unwrap();
    assert_eq!(measured["episodes"].as_array().unwrap().len(), 2);
    assert!(succeeded(&["eval", run, "--episodes", "1"]).contains("return"));

    let log = folder.join("episode.mcap");
    succeeded(&["record", run, "--out", log.to_str().unwrap()]);
    assert!(std::fs::read(&log).unwrap().starts_with(b"\x89MCAP0\r\n"));

    succeeded(&["plot", run]);
    assert!(std::fs::read(folder.join("learning_curve.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(std::fs::read_to_string(folder.join("learning_curve.svg")).unwrap().contains("seed 7"));
}

/// Processes started by `parent`, from the fourth field of their `stat`.
fn children(parent: u32) -> Vec<u32> {
    let processes = std::fs::read_dir("/proc").unwrap();
    let ids = processes.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
    let parent_of = |id: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse::<u32>().ok()
    };
    ids.filter(|id| parent_of(id) == Some(parent)).collect()
}

#[test]
fn a_killed_actor_is_replaced_and_changes_nothing() {
    let runs = Runs::new();
    let (killed, whole) = (runs.folder("killed"), runs.folder("whole"));
    let dir = format!("run.dir={}", killed.display());
    let more = [dir.as_str(), "run.iterations=30", "run.actors=1"];
    let mut child = Command::new(env!("CARGO_BIN_EXE_s2mia"))
        .args([&["train"], TINY, &more].concat())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    lines.by_ref().take(2).for_each(|line| drop(line.unwrap()));
    let actors = children(child.id());
    assert_eq!(actors.len(), 1);
    let kill = Command::new("kill").args(["-9", &actors[0].to_string()]).status().unwrap();
    assert!(kill.success());
    let rest: Vec<String> = lines.map(Result::unwrap).collect();
    let output = child.wait_with_output().unwrap();
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{rest:?}\n{log}");
    assert!(log.contains("starting another in its place"), "{rest:?}\n{log}");
    train(&whole, &["run.iterations=30", "run.actors=2"]);
    assert_eq!(inspect(&killed), inspect(&whole));
}
