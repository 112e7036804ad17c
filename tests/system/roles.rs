//! A learner and an actor started separately, as containers start them.

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::json;

use crate::processes::{Background, Learner, actor, has_begun, until};
use crate::runs::{Runs, error, failed, inspect, status, succeeded, success, text, train};

const SIXTY: &str = "run.iterations=60";
/// Six slots an iteration.
const TWELVE: [&str; 2] = [SIXTY, "environments.count=12"];

/// An address that was unused a moment ago.
fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

fn finishes(mut learner: Learner, mut actor: Background) {
    let last = learner.process.rest().pop().unwrap();
    assert!(last.starts_with("finished after iteration 60"), "{last}");
    actor.rest();
}

#[test]
fn threads_of_an_actor_that_starts_first_survive_a_restart_and_give_the_results_of_one_thread() {
    let runs = Runs::new();
    let (folder, address) = (runs.folder("six"), free_address());
    let url = format!("http://{address}");
    let mut six = actor(&url, &["--threads=6"]);
    let mut learner = Learner::at(&address, &folder, &TWELVE);
    until("six threads are registered", || status(&url)["actors"] == 6);
    has_begun(&folder);
    learner.process.signal("-TERM");
    assert!(learner.process.rest().pop().unwrap().starts_with("stopped after iteration"));
    assert!(six.is_running(), "the actor waits for the next learner");
    finishes(Learner::at(&address, &folder, &TWELVE), six);

    let alone = runs.folder("one");
    let learner = Learner::start(&alone, &TWELVE);
    let one = actor(&learner.url, &["--threads=1"]);
    finishes(learner, one);
    assert_eq!(inspect(&folder), inspect(&alone));
}

#[test]
fn a_learner_says_once_how_many_threads_have_no_slot() {
    let runs = Runs::new();
    let mut learner = Learner::start(&runs.folder("idle"), &["run.iterations=20"]);
    // Two slots.
    let log = learner.finish(&["--threads=3"]);
    let lines = log.lines().filter(|line| line.contains("actor threads has no slot"));
    let lines = lines.collect::<Vec<_>>();
    assert_eq!(lines.len(), 1, "{log}");
    assert!(lines[0].contains("1 of 3"), "{log}");
    assert!(lines[0].contains("resume with environments.per_slot=0"), "{log}");
}

/// A copy of the program that differs only in the commit that it was built from.
pub(crate) fn another_build(folder: &Path) -> PathBuf {
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
    let other = another_build(&runs.folder(""));
    let act = |learner: &Learner| {
        let mut actor = Command::new(&other);
        actor.args(["actor", "--learner", &learner.url]);
        actor
    };
    let mut learner = Learner::start(&runs.folder("strict"), &[SIXTY]);
    let refused = act(&learner).output().unwrap();
    let line = error(&refused);
    assert_eq!(refused.status.code(), Some(1), "{line}");
    assert!(line.contains("OTHER_BUILD") && line.contains("learner.other_builds=true"), "{line}");
    learner.process.stop();

    let allowed = [SIXTY, "learner.other_builds=true"];
    let mut learner = Learner::start(&runs.folder("admitted"), &allowed);
    success(&mut act(&learner));
    learner.process.rest();
}

#[test]
fn status_and_health_work_by_address_and_status_by_folder_and_for_ended_runs() {
    let runs = Runs::new();
    let folder = runs.folder("status");
    let mut learner = Learner::start(&folder, &[SIXTY]);
    let health = ["health", "--learner", &learner.url];
    succeeded(&health);
    let asked = status(&learner.url);
    assert_eq!(asked, status(text(&folder)));
    let figures = ["state", "iteration", "slots", "complete_slots", "actors"];
    assert_eq!(
        figures.map(|name| asked[name].clone()),
        [json!("running"), json!(0), json!(2), json!(0), json!(0)]
    );
    learner.process.stop();
    assert!(failed(&health, 1).contains(&learner.url));
    assert_eq!(status(text(&folder))["state"], "stopped");
    let line = succeeded(&["status", text(&folder)]);
    assert!(line.contains("is stopped: iteration 0 of 60") && line.contains("--resume"), "{line}");
    let short = runs.folder("short");
    train(&short, &["run.iterations=1", "run.actors=1"]);
    let line = succeeded(&["status", text(&short)]);
    assert!(line.contains("is finished: iteration 1 of 1") && line.lines().count() == 1, "{line}");
}
