//! Shutdown: the first signal writes a checkpoint and exits with status 0, even during an update; the second
//! exits at once.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::processes::{Background, until};
use crate::runs::{Runs, command, error, inspect, status, tiny, under};

/// Maximum duration of a stop.
const GRACE: Duration = Duration::from_secs(30);

/// The process that runs the tests may ignore SIGHUP, which processes inherit.
fn started(command: &Command) -> Background {
    let mut command = under("env", &["--default-signal=HUP"], command);
    Background::start(command.stdin(Stdio::piped()))
}

fn learner(folder: &Path, more: &[&str]) -> Command {
    tiny("learner", folder, &[&["--listen=127.0.0.1:0"], more].concat())
}

/// A learner during an update, and its actor.
struct Cluster {
    learner: Background,
    actor: Background,
}

impl Cluster {
    /// Waits until the learner is in an update of `epochs` passes.
    fn in_an_update(folder: &Path, epochs: &str) -> Self {
        let epochs = format!("update.epochs={epochs}");
        let own = ["run.iterations=2", "evaluation.every_steps=0", &epochs];
        let mut learner = started(&learner(folder, &own));
        let url = learner.url();
        let actor =
            started(&command(&["actor", "--learner", &url, "--exit-with-stdin", "--threads=5"]));
        until("the first iteration's slots are complete", || {
            let status = status(&url);
            status["slots"] == 2 && status["complete_slots"] == 2
        });
        Self { learner, actor }
    }

    /// Waits for the line that reports the stop.
    fn is_stopping(&mut self) {
        while !self.learner.line().starts_with("stopping after") {}
    }
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
    let mut learner = started(&learner(folder, &[]));
    let deadline = Instant::now() + GRACE;
    while !handles(&learner.process, TERMINATE) {
        assert!(Instant::now() < deadline, "the learner does not handle signals");
    }
    learner.signal("-TERM");
    let lines = learner.rest();
    assert_eq!(inspect(folder)["iteration"], 0);
    lines[0].clone()
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
        let mut cluster = Cluster::in_an_update(&runs.folder(name), "65536");
        cluster.learner.signal("-TERM");
        cluster.is_stopping();
        assert!(cluster.learner.is_running(), "it waits for the update");
        // Signals within half a second are one request.
        std::thread::sleep(Duration::from_millis(600));
        let begun = Instant::now();
        cluster.learner.signal(name);
        assert_eq!(cluster.learner.end().0, Some(status));
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }
}

#[test]
fn the_first_signal_during_an_update_leads_to_a_checkpoint_of_it_and_status_0() {
    let runs = Runs::new();
    // A session that ends sends further hang-ups and SIGTERM, and `timeout` SIGTERM twice, which changes nothing.
    for (names, further) in [
        (&["-TERM"] as &[&str], &[] as &[&str]),
        (&["-TERM", "-TERM"], &[]),
        (&["-HUP"], &["-HUP", "-TERM"]),
    ] {
        let folder = runs.folder(&names.concat());
        let mut cluster = Cluster::in_an_update(&folder, "400");
        let begun = Instant::now();
        names.iter().for_each(|name| cluster.learner.signal(name));
        cluster.is_stopping();
        further.iter().for_each(|name| cluster.learner.signal(name));
        cluster.learner.rest();
        assert!(begun.elapsed() < GRACE, "{:?}", begun.elapsed());
        assert_eq!(inspect(&folder)["iteration"], 1);
        // The actor also has to be stopped, since its learner has exited.
        cluster.actor.signal(names[0]);
        cluster.actor.rest();
    }
}

#[test]
fn a_hang_up_that_was_ignored_when_a_learner_started_stays_ignored() {
    let runs = Runs::new();
    let mut command = under("nohup", &[], &learner(&runs.folder("run"), &[]));
    let mut learner = Background::start(command.stdin(Stdio::null()));
    until("the learner handles signals", || handles(&learner.process, TERMINATE));
    let handles_hang_up = handles(&learner.process, HANG_UP);
    learner.stop();
    assert!(!handles_hang_up);
}

#[test]
fn a_limit_of_file_sizes_fails_checkpoints_and_the_run_and_kills_nothing() {
    let runs = Runs::new();
    let settings = ["run.iterations=3", "run.actors=1", "--page=off"];
    let limited = ["-c", "ulimit -f 40; exec \"$0\" \"$@\""];
    let output =
        under("sh", &limited, &tiny("train", &runs.folder("run"), &settings)).output().unwrap();
    let printed = error(&output);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    for then in ["training continues; retrying after the next", "training is over; retrying once"] {
        let line = printed.lines().find(|line| line.contains(then));
        assert!(line.is_some_and(|line| line.contains("checkpoint failed")), "{then}: {printed}");
    }
    assert!(printed.lines().last().unwrap().contains("File too large"), "{printed}");
}

#[test]
fn the_first_signal_ends_all_threads_of_an_actor_in_the_middle_of_their_slots() {
    let runs = Runs::new();
    let long = ["environments.steps=100000", "environments.count=10"];
    let mut learner = started(&learner(&runs.folder("long"), &long));
    let url = learner.url();
    let mut actor = started(&command(&["actor", "--learner", &url, "--threads=5"]));
    until("chunks of all threads have arrived", || {
        let leases = status(&url)["leases"].clone();
        let leases = leases.as_array().map_or(&[][..], Vec::as_slice);
        leases.iter().filter(|lease| lease["chunks"].as_u64() > Some(0)).count() >= 5
    });
    let begun = Instant::now();
    actor.stop();
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    learner.stop();
}
