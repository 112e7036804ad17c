//! A learner and an actor started separately, as containers start them.

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::json;

use crate::commands::{Background, failed};
use crate::runs::{Runs, TINY, inspect, succeeded, train};
use crate::waiting::{eventually, has_begun};

const SIXTY: &str = "run.iterations=60";

/// A learner in the background.
struct Learner(Background);

impl Learner {
    /// Starts a learner and waits until it is ready for actors.
    fn start(folder: &Path, address: &str, more: &[&str]) -> Self {
        let dir = format!("run.dir={}", folder.display());
        let own = ["--listen", address, dir.as_str(), SIXTY];
        let mut learner = Background::start(&[&["learner"], TINY, &own, more].concat());
        assert!(learner.line().contains("waits for actors"));
        Self(learner)
    }

    fn terminate(&mut self) -> String {
        self.0.signal("-TERM");
        self.end()
    }

    /// The last line of output, after success.
    fn end(&mut self) -> String {
        self.0.rest().pop().unwrap()
    }
}

/// An address that was unused a moment ago.
fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

fn actor(url: &str, threads: &str) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(["actor", "--learner", url, "--threads", threads]);
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

#[test]
fn an_actor_can_start_before_the_learner_and_survives_its_restart() {
    let runs = Runs::new();
    let folder = runs.folder("roles");
    let address = free_address();
    let mut actor = actor(&format!("http://{address}"), "1");
    let mut learner = Learner::start(&folder, &address, &[]);
    has_begun(&folder);
    assert!(learner.terminate().starts_with("stopped after iteration"));
    assert_eq!(actor.try_wait().unwrap(), None, "the actor waits for the next learner");
    let mut learner = Learner::start(&folder, &address, &[]);
    assert!(learner.end().starts_with("finished after iteration 60"));
    assert!(actor.wait().unwrap().success());
}

/// Trains six slots an iteration with one actor process of one thread.
fn train_with_one_thread(folder: &Path) -> serde_json::Value {
    let address = free_address();
    let mut learner = Learner::start(folder, &address, &["environments.count=12"]);
    let mut actor = actor(&format!("http://{address}"), "1");
    assert!(learner.end().starts_with("finished after iteration 60"));
    assert!(actor.wait().unwrap().success());
    inspect(folder)
}

#[test]
fn six_threads_and_a_restart_of_the_learner_give_the_results_of_one_thread() {
    let runs = Runs::new();
    let (folder, address) = (runs.folder("six"), free_address());
    let url = format!("http://{address}");
    let mut actor = actor(&url, "6");
    let mut learner = Learner::start(&folder, &address, &["environments.count=12"]);
    eventually(|| {
        let actors = status(&url)["actors"].clone();
        if actors == 6 { Ok(()) } else { Err(format!("{actors} of six threads are registered")) }
    });
    has_begun(&folder);
    assert!(learner.terminate().starts_with("stopped after iteration"));
    assert_eq!(actor.try_wait().unwrap(), None, "the actor waits for the next learner");
    let mut learner = Learner::start(&folder, &address, &["environments.count=12"]);
    assert!(learner.end().starts_with("finished after iteration 60"));
    assert!(actor.wait().unwrap().success());
    assert_eq!(inspect(&folder), train_with_one_thread(&runs.folder("one")));
}

#[test]
fn a_learner_says_once_how_many_threads_have_no_slot() {
    let runs = Runs::new();
    let address = free_address();
    let dir = format!("run.dir={}", runs.folder("idle").display());
    let own = ["learner", "--listen", &address, TINY[0], &dir, "run.iterations=20"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    let learner = command
        .args(own)
        .args(&TINY[1..])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Three threads, two slots.
    let mut actor = actor(&format!("http://{address}"), "3");
    let log = String::from_utf8(learner.wait_with_output().unwrap().stderr).unwrap();
    assert!(actor.wait().unwrap().success());
    let lines = log.lines().filter(|line| line.contains("actor threads have no slot"));
    let lines = lines.collect::<Vec<_>>();
    assert_eq!(lines.len(), 1, "{log}");
    assert!(
        lines[0].contains("1 of 3") && lines[0].contains("resume with environments.per_slot=0"),
        "{log}"
    );
}

/// A copy of the program that differs only in the commit that it was built from.
fn another_build(folder: &Path) -> PathBuf {
    let version = succeeded(&["--version"]);
    let commit = version.trim_end().split_once('+').unwrap().1.as_bytes();
    let mut program = fs::read(env!("CARGO_BIN_EXE_s2mia")).unwrap();
    let other: Vec<u8> = commit.iter().rev().copied().collect();
    let places: Vec<usize> = (0..=program.len() - commit.len())
        .filter(|at| program[*at] == commit[0] && program[*at..].starts_with(commit))
        .collect();
    assert!(!places.is_empty(), "the program does not contain its commit");
    places.iter().for_each(|at| program[*at..at + other.len()].copy_from_slice(&other));
    let path = folder.join("another-s2mia");
    fs::write(&path, program).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o700)).unwrap();
    path
}

#[test]
fn an_actor_of_another_build_takes_part_only_if_the_operator_admits_it() {
    let runs = Runs::new();
    let other = another_build(runs.folder("").as_path());
    let act = |address: &str| {
        let url = format!("http://{address}");
        Command::new(&other).args(["actor", "--learner", &url]).output().unwrap()
    };
    let (address, folder) = (free_address(), runs.folder("strict"));
    let mut learner = Learner::start(&folder, &address, &[]);
    let refused = act(&address);
    let line = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.status.code(), Some(1), "{line}");
    assert!(line.contains("OTHER_BUILD") && line.contains("learner.other_builds=true"), "{line}");
    learner.terminate();

    let address = free_address();
    let admitted = runs.folder("admitted");
    let mut learner = Learner::start(&admitted, &address, &["learner.other_builds=true"]);
    let acted = act(&address);
    assert!(acted.status.success(), "{}", String::from_utf8_lossy(&acted.stderr));
    assert!(learner.end().starts_with("finished after iteration 60"));
}

fn status(of: &str) -> serde_json::Value {
    serde_json::from_str(&succeeded(&["status", of, "--json"])).unwrap()
}

#[test]
fn status_works_by_address_by_folder_and_for_ended_runs() {
    let runs = Runs::new();
    let (folder, address) = (runs.folder("status"), free_address());
    let path = folder.to_str().unwrap();
    let mut learner = Learner::start(&folder, &address, &[]);
    let asked = status(&format!("http://{address}"));
    assert_eq!(asked, status(path));
    let figures = ["state", "iteration", "slots", "complete_slots", "actors"];
    assert_eq!(
        figures.map(|name| asked[name].clone()),
        [json!("running"), json!(0), json!(2), json!(0), json!(0)]
    );
    learner.terminate();
    assert_eq!(status(path)["state"], "stopped");
    let line = succeeded(&["status", path]);
    assert!(line.contains("is stopped: iteration 0 of 60") && line.contains("--resume"), "{line}");
    train(&runs.folder("short"), &["run.iterations=1", "run.actors=1"]);
    let line = succeeded(&["status", runs.folder("short").to_str().unwrap()]);
    assert!(line.contains("is finished: iteration 1 of 1") && line.lines().count() == 1, "{line}");
}

#[test]
fn verify_determinism_compares_three_runs_whose_arguments_override_variables() {
    let runs = Runs::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.arg("train").args(TINY).arg("--verify-determinism=3");
    command.env("S2MIA__RUN__SEED", "1").env("S2MIA__RUN__DIR", runs.folder("variable"));
    let output = command.output().unwrap();
    let (told, log) =
        [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap()).into();
    assert!(output.status.success() && log.is_empty(), "{told}{log}");
    let lines = told.lines().collect::<Vec<_>>();
    let states = lines[..3].iter().map(|line| line.split_whitespace().last().unwrap());
    assert!(states.clone().all(|state| state.len() == 64 && Some(state) == states.clone().next()));
    assert_eq!(lines[3..], ["deterministic over 3 iterations: all states are equal"]);
}

#[test]
fn a_learner_is_healthy_only_while_it_serves() {
    let runs = Runs::new();
    let address = free_address();
    let url = format!("http://{address}");
    let health = ["health", "--learner", url.as_str()];
    let mut learner = Learner::start(&runs.folder("health"), &address, &[]);
    succeeded(&health);
    learner.terminate();
    assert!(failed(&health, 1).contains(&url));
}
