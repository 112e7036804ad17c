//! Authorised clients watch and stop a running learner, and its run can be resumed.

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use serde_json::{Value, json};

use crate::processes::{Background, Learner, has_begun};
use crate::runs::{
    Runs, command, error, failed, failure, inspect, s2mia, status, succeeded, text, tiny,
};

const THIRTY: &str = "run.iterations=30";

/// Starts a run of this `length` and waits until it has begun.
fn begun(folder: &Path, length: &str) -> Background {
    let run = Background::start(&mut tiny("train", folder, &[length]));
    has_begun(folder);
    run
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
    let mut run = begun(&folder, "run.iterations=1000000");
    let (url, token) = (address(&folder), folder.join("token"));
    assert_eq!(std::fs::metadata(&token).unwrap().permissions().mode() & 0o777, 0o600);
    for order in [&["stop", &url][..], &["actor", "--learner", &url]] {
        let answer = s2mia(order);
        let printed = error(&answer);
        let line = printed.lines().last().unwrap();
        assert_eq!(answer.status.code(), Some(1), "{printed}");
        assert!(line.contains("has no token") && line.contains(text(&token)), "{printed}");
    }
    assert_eq!(status(&url)["state"], "running", "the status needs no token");
    succeeded(&["stop", text(&folder)]);
    run.rest();
}

#[test]
fn a_token_is_not_sent_in_plain_text_to_another_machine() {
    let mut stop = command(&["stop", "http://192.0.2.1:50051", "--timeout-secs", "0.5"]);
    let line = failure(stop.env("S2MIA_TOKEN", "a".repeat(64)), 1);
    let advice = "not sent in plain text to another machine; use http://127.0.0.1:PORT on the learner's machine";
    assert!(line.contains(advice), "{line}");
}

#[test]
fn a_learner_on_all_addresses_is_stopped_by_its_folder_and_token() {
    let runs = Runs::new();
    let folder = runs.folder("reachable");
    let everywhere = ["--listen=0.0.0.0:0", "--insecure-allow-remote"];
    let mut learner = tiny("learner", &folder, &everywhere);
    let mut run = Background::start(learner.env("S2MIA_TOKEN", "a".repeat(64)));
    // It answers only when the folder has its address.
    status(&run.url());
    succeeded(&["stop", text(&folder)]);
    run.rest();
}

#[test]
fn a_run_that_a_client_stops_says_so_to_its_watcher_and_a_later_one_and_can_be_resumed() {
    let runs = Runs::new();
    let stopped = runs.folder("stopped by a client");
    let of = text(&stopped);
    let mut run = begun(&stopped, THIRTY);
    let mut watch = Background::start(&mut command(&["watch", of]));
    watch.line();
    assert!(succeeded(&["stop", of]).contains("stops after a checkpoint"));
    run.rest();
    let last = watch.rest().pop().unwrap();
    assert!(last.starts_with("stopped after iteration "), "{last}");
    assert_eq!(succeeded(&["watch", of]).trim_end().split("  ").next(), last.split("  ").next());
    let left = status(of);
    assert_eq!(left["state"], "stopped");
    assert_eq!(left["iteration"], inspect(&stopped)["iteration"]);
    assert!(failed(&["stop", of], 1).contains("no learner works on"));
    succeeded(&["train", "--resume", of]);
    assert_eq!(inspect(&stopped)["iteration"], 30);
}

#[test]
fn waiting_for_a_learner_is_reported_once_with_its_reason() {
    let runs = Runs::new();
    let folder = runs.folder("stopped");
    let mut learner = begun(&folder, THIRTY);
    let of = text(&folder);
    let mut watch = Background::start(&mut command(&["watch", of, "--max-outage-secs", "1.5"]));
    // The first line shows that the watcher has met the learner.
    watch.line();
    let printed = learner.stop();
    // The requests of actors that wait for work end without a refusal.
    assert!(!printed.contains("lease_slots from "), "{printed}");
    assert_eq!(watch.end().0, Some(1));
    let printed = watch.log();
    let lines: Vec<&str> = printed.lines().collect();
    let why = format!("the learner of {of} has ended; `s2mia train --resume {of}` starts one");
    assert!(lines[0].contains("waiting up to 1.5 s (--max-outage-secs)"), "{printed}");
    assert_eq!(lines[1..], [format!("error: {why}")]);
}

#[test]
fn a_watcher_gets_each_iteration_once_across_a_restart_and_then_the_end() {
    let runs = Runs::new();
    let folder = runs.folder("watched");
    let of = text(&folder);
    let mut first = begun(&folder, THIRTY);
    let mut watch = Background::start(&mut command(&["watch", of, "--json"]));
    let begin = watch.line();
    first.stop();
    let mut second = Learner::start(&folder, &[THIRTY]);
    second.process.logs("watch_run from", 1);
    second.finish(&[]);
    let lines = [begin].into_iter().chain(watch.rest());
    let lines: Vec<Value> = lines.map(|line| serde_json::from_str(&line).unwrap()).collect();
    let (ends, iterations): (Vec<&Value>, Vec<&Value>) =
        lines.iter().partition(|line| line["end"] != Value::Null);
    let seen: Vec<u64> =
        iterations.iter().map(|line| line["iteration"].as_u64().unwrap()).collect();
    assert_eq!(seen, (1..=30).collect::<Vec<_>>());
    assert!(iterations.iter().all(|line| line["env_steps_per_sec"].as_f64() > Some(0.0)));
    assert_eq!(ends.iter().map(|line| &line["end"]).collect::<Vec<_>>(), ["stopped", "finished"]);
    assert_eq!(ends[1]["iteration"], json!(30));
    assert_eq!(ends[1]["evaluation"]["iteration"], json!(30));
    let at_rest = succeeded(&["watch", of]);
    assert!(at_rest.starts_with("finished after iteration 30, "), "{at_rest}");
}
