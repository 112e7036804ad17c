//! Shutdown: the first signal writes a checkpoint and exits with status 0, even during an update; the second
//! exits at once.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::commands::Background;
use crate::runs::{Runs, TINY, inspect, s2mia};

/// Maximum duration of a stop.
const GRACE: Duration = Duration::from_secs(30);

/// The process that runs the tests may ignore SIGHUP, which processes inherit.
fn started(arguments: &[&str]) -> Background {
    let mut command = Command::new("env");
    command.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_s2mia")]).args(arguments);
    Background::of(command.stdin(Stdio::piped()).stderr(Stdio::null()))
}

/// A learner during an update, and its actor.
struct Cluster {
    learner: Background,
    actor: Background,
}

impl Cluster {
    /// Waits until the learner is in an update of `epochs` passes.
    fn in_an_update(folder: &Path, epochs: &str) -> Self {
        let (dir, epochs) =
            (format!("run.dir={}", folder.display()), format!("update.epochs={epochs}"));
        let own = ["run.iterations=2", "evaluation.every_steps=0", &dir, &epochs];
        let mut learner = started(&[&["learner", "--listen=127.0.0.1:0"], TINY, &own].concat());
        let url = learner.url();
        let actor = started(&["actor", "--learner", &url, "--exit-with-stdin", "--threads=5"]);
        let patience = Instant::now() + GRACE;
        while !all_collected(&url) {
            assert!(Instant::now() < patience, "the first iteration's slots are not complete");
        }
        Self { learner, actor }
    }

    /// Waits for the line that reports the stop.
    fn is_stopping(&mut self) {
        while !self.learner.line().starts_with("stopping after") {}
    }
}

fn all_collected(url: &str) -> bool {
    let told = s2mia(&["status", url, "--json"]);
    let status: serde_json::Value = serde_json::from_slice(&told.stdout).unwrap_or_default();
    status["slots"] == 2 && status["complete_slots"] == 2
}

/// Numbers of signals.
const HANG_UP: u32 = 1;
const TERMINATE: u32 = 15;

/// Whether the process handles a signal itself.
fn handles(process: &Child, signal: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
    u64::from_str_radix(caught.trim(), 16).unwrap() & (1 << (signal - 1)) != 0
}

/// Sends SIGTERM to a learner as soon as it handles it. Returns the first line that it printed.
fn stopped_early(folder: &Path) -> String {
    let dir = format!("run.dir={}", folder.display());
    let mut learner = started(&[&["learner", "--listen=127.0.0.1:0"], TINY, &[&dir]].concat());
    let patience = Instant::now() + GRACE;
    while !handles(&learner.process, TERMINATE) {
        assert!(Instant::now() < patience, "the learner does not handle signals");
    }
    learner.signal("-TERM");
    assert!(learner.process.wait().unwrap().success());
    assert_eq!(inspect(folder)["iteration"], 0);
    learner.line()
}

#[test]
fn a_learner_that_is_asked_to_stop_while_it_starts_stops_with_a_checkpoint() {
    let runs = Runs::new();
    // A busy machine may deliver the signal later.
    let mut lines = (0..10).map(|attempt| stopped_early(&runs.folder(&attempt.to_string())));
    assert!(lines.any(|line| line.starts_with("stopping after")));
}

#[test]
fn the_second_signal_ends_a_learner_at_once_with_the_status_of_the_signal() {
    let runs = Runs::new();
    for (name, status) in [("-TERM", 143), ("-INT", 130)] {
        let mut cluster = Cluster::in_an_update(&runs.folder(name), "10000000");
        cluster.learner.signal("-TERM");
        cluster.is_stopping();
        assert_eq!(cluster.learner.process.try_wait().unwrap(), None, "it waits for the update");
        let begun = Instant::now();
        cluster.learner.signal(name);
        assert_eq!(cluster.learner.process.wait().unwrap().code(), Some(status));
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }
}

#[test]
fn the_first_signal_during_an_update_leads_to_a_checkpoint_of_it_and_status_0() {
    let runs = Runs::new();
    let stopped = runs.folder("stopped");
    let mut cluster = Cluster::in_an_update(&stopped, "400");
    let begun = Instant::now();
    cluster.learner.signal("-TERM");
    cluster.is_stopping();
    assert!(cluster.learner.process.wait().unwrap().success());
    assert!(begun.elapsed() < GRACE, "{:?}", begun.elapsed());
    assert_eq!(inspect(&stopped)["iteration"], 1);
    // The actor also has to be stopped, since its learner has exited.
    cluster.actor.signal("-TERM");
    assert_eq!(cluster.actor.process.wait().unwrap().code(), Some(0));
}

#[test]
fn a_hang_up_stops_a_learner_with_a_checkpoint_and_further_ones_change_nothing() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let mut cluster = Cluster::in_an_update(&folder, "400");
    cluster.learner.signal("-HUP");
    cluster.is_stopping();
    // A session that ends sends both.
    cluster.learner.signal("-HUP");
    cluster.learner.signal("-TERM");
    assert_eq!(cluster.learner.process.wait().unwrap().code(), Some(0));
    assert_eq!(inspect(&folder)["iteration"], 1);
    cluster.actor.signal("-HUP");
    assert_eq!(cluster.actor.process.wait().unwrap().code(), Some(0));
}

#[test]
fn a_hang_up_that_was_ignored_when_a_learner_started_stays_ignored() {
    let runs = Runs::new();
    let dir = format!("run.dir={}", runs.folder("run").display());
    let mut command = Command::new("nohup");
    let learner =
        [&[env!("CARGO_BIN_EXE_s2mia"), "learner", "--listen=127.0.0.1:0"], TINY, &[&dir]];
    command.args(learner.concat()).stdin(Stdio::null()).stderr(Stdio::null());
    let mut learner = Background::of(&mut command);
    let patience = Instant::now() + GRACE;
    while !handles(&learner.process, TERMINATE) {
        assert!(Instant::now() < patience, "the learner does not handle signals");
    }
    let handles_hang_up = handles(&learner.process, HANG_UP);
    learner.signal("-TERM");
    assert!(learner.process.wait().unwrap().success());
    assert!(!handles_hang_up);
}

#[test]
fn a_limit_of_file_sizes_fails_checkpoints_and_the_run_and_kills_nothing() {
    let runs = Runs::new();
    let dir = format!("run.dir={}", runs.folder("run").display());
    let limited = ["-c", "ulimit -f 40; exec \"$0\" train \"$@\"", env!("CARGO_BIN_EXE_s2mia")];
    let settings = [TINY, &["run.iterations=3", "run.actors=1", "--page=off", &dir]];
    let output = Command::new("sh").args(limited).args(settings.concat()).output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("checkpoint failed"), "{told}");
    assert!(told.lines().last().unwrap().contains("File too large"), "{told}");
}

#[test]
fn the_first_signal_ends_all_threads_of_an_actor_in_the_middle_of_their_slots() {
    let runs = Runs::new();
    let dir = format!("run.dir={}", runs.folder("long").display());
    let long = ["environments.steps=100000", "environments.count=10", &dir];
    let mut learner = started(&[&["learner", "--listen=127.0.0.1:0"], TINY, &long].concat());
    let url = learner.url();
    let mut actor = started(&["actor", "--learner", &url, "--threads=5"]);
    let patience = Instant::now() + GRACE;
    while leases_with_chunks(&url) < 5 {
        assert!(Instant::now() < patience, "not all threads step");
    }
    let begun = Instant::now();
    actor.signal("-TERM");
    assert_eq!(actor.process.wait().unwrap().code(), Some(0));
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    learner.signal("-TERM");
    assert!(learner.process.wait().unwrap().success());
}

/// Number of leases under which chunks have arrived.
fn leases_with_chunks(url: &str) -> usize {
    let told = s2mia(&["status", url, "--json"]);
    let status: serde_json::Value = serde_json::from_slice(&told.stdout).unwrap_or_default();
    let leases = status["leases"].as_array().map_or(&[][..], Vec::as_slice);
    leases.iter().filter(|lease| lease["chunks"].as_u64() > Some(0)).count()
}
