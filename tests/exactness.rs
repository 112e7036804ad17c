//! The promise, cell by cell: whatever is killed, frozen or stopped on the way, and however many actors and threads
//! there are, a run ends with the same weights, optimiser and densities, bit for bit.
//!
//! Every pair of values of two columns stands in some row of `CELLS`.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/processes.rs"]
mod processes;
#[path = "system/runs.rs"]
mod runs;

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use runs::{Runs, TINY, inspect, succeeded, train};

/// What happens to a run of six iterations.
#[derive(Clone, Copy, Debug)]
enum Happening {
    Nothing,
    /// An actor is killed while it steps.
    ActorKilled,
    /// An actor is frozen for longer than its lease lives, and thawed.
    ActorFrozen,
    /// The learner dies at this point, and the run is taken up again.
    LearnerDies(&'static str),
    /// Stopped after three iterations, and taken up again.
    Stopped,
}

use Happening::{ActorFrozen, ActorKilled, LearnerDies, Nothing, Stopped};

/// Actors, threads, and what happens.
const CELLS: &[(u32, u32, Happening)] = &[
    (1, 1, Nothing),
    (2, 2, Nothing),
    (4, 1, Nothing),
    (1, 2, ActorKilled),
    (2, 1, ActorKilled),
    (4, 2, ActorKilled),
    (1, 1, ActorFrozen),
    (2, 2, ActorFrozen),
    (4, 1, ActorFrozen),
    (1, 2, LearnerDies("after-collect@3")),
    (2, 1, LearnerDies("after-collect@1")),
    (4, 2, LearnerDies("mid-update@3")),
    (1, 1, LearnerDies("mid-update@2")),
    (2, 2, LearnerDies("after-publish@4")),
    (4, 1, LearnerDies("after-publish@1")),
    (1, 2, LearnerDies("mid-checkpoint@2")),
    (2, 1, LearnerDies("mid-checkpoint@4")),
    (1, 1, Stopped),
    (2, 2, Stopped),
    (4, 2, Stopped),
];

const SIX: &str = "run.iterations=6";

fn start(folder: &Path, more: &[&str]) -> Child {
    let dir = format!("run.dir={}", folder.display());
    let arguments = [&["train"], TINY, &[dir.as_str()], more].concat();
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// The actor processes of a run, as soon as there are as many as it wants.
fn actors(run: &Child, wanted: u32) -> Vec<u32> {
    let patience = Instant::now() + Duration::from_secs(30);
    loop {
        let found = processes::children(run.id());
        if found.len() as u32 >= wanted {
            return found;
        }
        assert!(Instant::now() < patience, "{} of {wanted} actors have started", found.len());
        std::thread::yield_now();
    }
}

fn signal(process: u32, name: &str) {
    let sent = Command::new("kill").args([name, &process.to_string()]).status().unwrap();
    assert!(sent.success());
}

/// Waits until the run's metrics hold a line: the run is under way.
fn under_way(folder: &Path) {
    let patience = Instant::now() + Duration::from_secs(30);
    let begun = || std::fs::metadata(folder.join("metrics.jsonl")).is_ok_and(|file| file.len() > 0);
    while !begun() {
        assert!(Instant::now() < patience, "no iteration in half a minute");
        std::thread::yield_now();
    }
}

fn play(folder: &Path, (count, threads, happening): (u32, u32, Happening)) {
    let (actors_setting, threads) =
        (format!("run.actors={count}"), format!("learner.threads={threads}"));
    let settings = [SIX, actors_setting.as_str(), threads.as_str()];
    let resume = || {
        let mut arguments = vec!["train", "--resume", folder.to_str().unwrap()];
        arguments.extend(settings);
        succeeded(&arguments);
    };
    match happening {
        Nothing => drop(train(folder, &settings)),
        ActorKilled => {
            let mut run = start(folder, &settings);
            under_way(folder);
            signal(actors(&run, count)[0], "-KILL");
            assert!(run.wait().unwrap().success());
        }
        ActorFrozen => {
            let lease = ["lease.ttl_secs=0.4", "lease.heartbeat_secs=0.1"];
            let mut run = start(folder, &[&settings[..], &lease].concat());
            under_way(folder);
            let frozen = actors(&run, count)[0];
            signal(frozen, "-STOP");
            // Longer than the lease lives: with other actors the run goes on meanwhile, with one it waits.
            std::thread::sleep(Duration::from_millis(800));
            signal(frozen, "-CONT");
            assert!(run.wait().unwrap().success());
        }
        LearnerDies(point) => {
            let mut run = start(folder, &[&settings[..], &["--die-at", point]].concat());
            assert!(!run.wait().unwrap().success(), "{point} was never reached");
            resume();
        }
        Stopped => {
            let stop = ["run.iterations=3", settings[1], settings[2]];
            train(folder, &stop);
            resume();
        }
    }
}

#[test]
fn every_cell_ends_with_the_same_state_bit_for_bit() {
    let runs = Runs::new();
    let states: Vec<serde_json::Value> = CELLS
        .iter()
        .enumerate()
        .map(|(index, cell)| {
            let folder = runs.folder(&index.to_string());
            play(&folder, *cell);
            inspect(&folder)
        })
        .collect();
    for (cell, state) in CELLS.iter().zip(&states) {
        assert_eq!(state, &states[0], "{cell:?}");
    }
    assert_eq!(states[0]["iteration"], 6);
}
