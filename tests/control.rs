//! Authorised clients watch and stop a running learner. A resume ends in the same state as an undisturbed run.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/runs.rs"]
mod runs;
#[path = "system/waiting.rs"]
mod waiting;

use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::{Value, json};

use runs::{Runs, TINY, inspect, s2mia, succeeded, train};
use waiting::has_begun;

const THIRTY: &str = "run.iterations=30";

fn background(arguments: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

fn terminate(process: &Child) {
    let sent = Command::new("kill").args(["-TERM", &process.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

/// Starts a run of this `length` and waits until it has begun.
fn begun(folder: &Path, length: &str) -> Child {
    let dir = format!("run.dir={}", folder.display());
    let run = background(&[&["train"], TINY, &[dir.as_str(), length]].concat());
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
    assert!(run.wait().unwrap().success());
}

#[test]
fn a_run_that_a_client_stops_can_be_resumed() {
    let runs = Runs::new();
    let (stopped, quiet) = (runs.folder("stopped"), runs.folder("quiet"));
    let of = stopped.to_str().unwrap();
    let mut run = begun(&stopped, THIRTY);
    assert!(succeeded(&["stop", of]).contains("stops after a checkpoint"));
    assert!(run.wait().unwrap().success());
    let left = status(of);
    assert_eq!(
        (&left["state"], &left["iteration"]),
        (&json!("stopped"), &inspect(&stopped)["iteration"])
    );
    let answer = s2mia(&["stop", of]);
    let line = String::from_utf8(answer.stderr).unwrap();
    assert_eq!(answer.status.code(), Some(1));
    assert!(line.contains("no learner works on") && line.lines().count() == 1, "{line}");
    succeeded(&["train", "--resume", of]);
    train(&quiet, &[THIRTY]);
    assert_eq!(inspect(&stopped), inspect(&quiet));
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
    terminate(&learner);
    assert!(learner.wait().unwrap().success());
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
    let mut watch = background(&["watch", of]);
    let mut told = BufReader::new(watch.stdout.take().unwrap()).lines();
    told.next().unwrap().unwrap();
    succeeded(&["stop", of]);
    assert!(learner.wait().unwrap().success());
    assert!(watch.wait().unwrap().success());
    let last = told.last().unwrap().unwrap();
    assert!(last.starts_with("stopped after iteration "), "{last}");
    assert_eq!(succeeded(&["watch", of]).trim_end().split("  ").next(), last.split("  ").next());
}

#[test]
fn a_watcher_gets_each_iteration_once_across_a_restart_and_then_the_end() {
    let runs = Runs::new();
    let folder = runs.folder("watched");
    let of = folder.to_str().unwrap();
    let mut first = begun(&folder, THIRTY);
    let mut watch = background(&["watch", of, "--json"]);
    let mut told = BufReader::new(watch.stdout.take().unwrap()).lines();
    let begin = told.next().unwrap().unwrap();
    terminate(&first);
    assert!(first.wait().unwrap().success());
    let mut second = watched(&folder);
    succeeded(&["actor", "--learner", &address(&folder)]);
    assert!(second.wait().unwrap().success());
    let rest: Vec<String> = told.map(Result::unwrap).collect();
    assert!(watch.wait().unwrap().success());
    let lines = [begin].into_iter().chain(rest);
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
