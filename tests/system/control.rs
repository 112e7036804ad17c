//! Authorised clients watch and stop a running learner, and its run can be resumed.

use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::{Value, json};

use crate::commands::{Background, failed};
use crate::runs::{Runs, TINY, inspect, s2mia, succeeded};
use crate::waiting::has_begun;

const THIRTY: &str = "run.iterations=30";

/// Starts a run of this `length` and waits until it has begun.
fn begun(folder: &Path, length: &str) -> Background {
    let dir = format!("run.dir={}", folder.display());
    let run = Background::start(&[&["train"], TINY, &[dir.as_str(), length]].concat());
    has_begun(folder);
    run
}

fn status(of: &str) -> Value {
    serde_json::from_str(&succeeded(&["status", of, "--json"])).unwrap()
}

/// The URL of a run's learner.
fn address(folder: &Path) -> String {
    let address = std::fs::read_to_string(folder.join("address")).unwrap();
    format!("http://{}", address.trim())
}

#[test]
fn a_stop_without_the_token_is_refused_and_the_run_continues() {
    let runs = Runs::new();
    let folder = runs.folder("guarded");
    let of = folder.to_str().unwrap();
    let mut run = begun(&folder, "run.iterations=1000000");
    let (url, token) = (address(&folder), folder.join("token"));
    assert_eq!(std::fs::metadata(&token).unwrap().permissions().mode() & 0o777, 0o600);
    for order in ["stop", "actor --learner"] {
        let arguments: Vec<&str> = order.split(' ').chain([url.as_str()]).collect();
        let answer = s2mia(&arguments);
        let told = String::from_utf8(answer.stderr).unwrap();
        let line = told.lines().last().unwrap();
        assert_eq!(answer.status.code(), Some(1), "{told}");
        assert!(line.contains("has no token") && line.contains(token.to_str().unwrap()), "{told}");
    }
    assert_eq!(status(&url)["state"], "running", "the status needs no token");
    succeeded(&["stop", of]);
    run.rest();
}

#[test]
fn a_run_that_a_client_stops_can_be_resumed() {
    let runs = Runs::new();
    let stopped = runs.folder("stopped");
    let of = stopped.to_str().unwrap();
    let mut run = begun(&stopped, THIRTY);
    assert!(succeeded(&["stop", of]).contains("stops after a checkpoint"));
    run.rest();
    let left = status(of);
    assert_eq!(
        (&left["state"], &left["iteration"]),
        (&json!("stopped"), &inspect(&stopped)["iteration"])
    );
    assert!(failed(&["stop", of], 1).contains("no learner works on"));
    succeeded(&["train", "--resume", of]);
    assert_eq!(inspect(&stopped)["iteration"], 30);
}

/// A learner that resumes the run in `folder` and has a watcher.
fn watched(folder: &Path) -> Child {
    let dir = format!("run.dir={}", folder.display());
    let arguments = [&["learner", "--listen=127.0.0.1:0"], TINY, &[dir.as_str(), THIRTY]].concat();
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(arguments).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut learner = command.spawn().unwrap();
    let mut log = BufReader::new(learner.stderr.take().unwrap()).lines();
    assert!(log.any(|line| line.unwrap().contains("watch_run from")));
    // Otherwise the learner's output would be closed.
    std::thread::Builder::new().name("log".into()).spawn(move || log.for_each(drop)).unwrap();
    learner
}

#[test]
fn waiting_for_a_learner_is_reported_once_with_its_reason() {
    let runs = Runs::new();
    let folder = runs.folder("stopped");
    let mut learner = begun(&folder, THIRTY);
    let of = folder.to_str().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(["watch", of, "--max-outage-secs", "1.5"]);
    let watch = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut watch = watch.unwrap();
    // The first line shows that the watcher has met the learner.
    let mut lines = BufReader::new(watch.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    learner.signal("-TERM");
    learner.rest();
    let output = watch.wait_with_output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    let lines: Vec<&str> = told.lines().collect();
    assert_eq!((output.status.code(), lines.len()), (Some(1), 2), "{told}");
    let why = format!("the learner of {of} has ended; `s2mia train --resume {of}` starts one");
    assert!(lines[0].contains("waiting up to 1.5 s (--max-outage-secs)"), "{told}");
    assert_eq!(lines[1], format!("error: {why}"));
}

#[test]
fn a_watcher_of_a_run_that_a_client_stops_says_so_and_ends_as_does_a_later_one() {
    let runs = Runs::new();
    let folder = runs.folder("stopped by a client");
    let mut learner = begun(&folder, THIRTY);
    let of = folder.to_str().unwrap();
    let mut watch = Background::start(&["watch", of]);
    watch.line();
    succeeded(&["stop", of]);
    learner.rest();
    let last = watch.rest().pop().unwrap();
    assert!(last.starts_with("stopped after iteration "), "{last}");
    assert_eq!(succeeded(&["watch", of]).trim_end().split("  ").next(), last.split("  ").next());
}

#[test]
fn a_watcher_gets_each_iteration_once_across_a_restart_and_then_the_end() {
    let runs = Runs::new();
    let folder = runs.folder("watched");
    let of = folder.to_str().unwrap();
    let mut first = begun(&folder, THIRTY);
    let mut watch = Background::start(&["watch", of, "--json"]);
    let begin = watch.line();
    first.signal("-TERM");
    first.rest();
    let mut second = watched(&folder);
    succeeded(&["actor", "--learner", &address(&folder)]);
    assert!(second.wait().unwrap().success());
    let lines = [begin].into_iter().chain(watch.rest());
    let lines: Vec<Value> = lines.map(|line| serde_json::from_str(&line).unwrap()).collect();
    let (ends, iterations): (Vec<&Value>, Vec<&Value>) =
        lines.iter().partition(|line| line["end"] != Value::Null);
    let seen: Vec<u64> =
        iterations.iter().map(|line| line["iteration"].as_u64().unwrap()).collect();
    assert_eq!(seen, (1..=30).collect::<Vec<_>>());
    assert!(iterations.iter().all(|line| line["env_steps_per_sec"].as_f64() > Some(0.0)));
    assert_eq!(ends.iter().map(|line| &line["end"]).collect::<Vec<_>>(), ["stopped", "finished"]);
    assert_eq!(
        (&ends[1]["iteration"], &ends[1]["evaluation"]["iteration"]),
        (&json!(30), &json!(30))
    );
    let at_rest = succeeded(&["watch", of]);
    assert!(at_rest.starts_with("finished after iteration 30, "), "{at_rest}");
}
