//! Whole runs with real processes: policies learn, signals and killed actors end no run, and every tool reads a run's files.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::commands::{Background, refused, signal};
use crate::processes::children;
use crate::runs::{Runs, TINY, inspect, succeeded, train};

/// Trains the game with the settings of its task file.
fn train_cue(folder: &Path, more: &[&str]) -> String {
    let dir = format!("run.dir={}", folder.display());
    succeeded(&[&["train", "cue-2x1", "run.seed=3", dir.as_str()], more].concat())
}

#[test]
fn a_shared_cue_is_learnt_by_either_algorithm() {
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
fn a_receiver_learns_what_the_sender_alone_observes() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let dir = format!("run.dir={}", folder.display());
    let length = ["run.env_steps=80000", "run.actors=2", "evaluation.every_steps=80000"];
    succeeded(&[&["train", "signal-2x1", "run.seed=3", dir.as_str()], &length[..]].concat());
    // Without communication the best return is 33.7; the optimum is 50.
    assert!(last_evaluation(&folder).1.as_f64().unwrap() > 45.0);
}

#[test]
fn a_resume_rejects_changed_settings() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=1", "run.actors=1"]);
    let folder = folder.to_str().unwrap();
    for (setting, key) in [
        ("update.clip=0.3", "`update.clip`"),
        ("algorithm=happo", "`algorithm`"),
        ("run.seed=8", "`run.seed`"),
    ] {
        let line = refused(&["train", "--resume", folder, setting]);
        assert!(line.contains(key) && line.contains("cannot change on resume"), "{line}");
    }
    let dir = format!("run.dir={folder}");
    assert!(refused(&[&["train"], TINY, &[&dir]].concat()).contains("--resume"));
}

#[test]
fn a_signal_leaves_a_checkpoint_and_status_zero() {
    let runs = Runs::new();
    let stopped = runs.folder("stopped");
    let dir = format!("run.dir={}", stopped.display());
    let arguments =
        [&["train"], TINY, &[dir.as_str(), "run.iterations=6", "run.actors=1"]].concat();
    let mut child = Background::start(&arguments);
    // The third line follows the first iteration or evaluation.
    (0..3).for_each(|_| drop(child.line()));
    child.signal("-TERM");
    let rest = child.rest();
    assert!(rest.iter().any(|line| line.starts_with("checkpoint: ")), "{rest:?}");
    succeeded(&["train", "--resume", stopped.to_str().unwrap()]);
    assert_eq!(inspect(&stopped)["iteration"], 6);
}

#[test]
fn every_tool_reads_the_files_of_a_run() {
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

    let told = succeeded(&["film", run, "--frames", "5"]);
    assert!(told.contains("5 frames from 5.00 s to 5.20 s") && told.contains("m/s"), "{told}");
    let film = std::fs::read(folder.join("film.png")).unwrap();
    assert!(film.starts_with(b"\x89PNG"));
    // Four frames of 400 pixels side by side, two rows of 270 with their times, six agents below.
    assert_eq!(film[16..24], [1660_u32.to_be_bytes(), 634_u32.to_be_bytes()].concat());

    succeeded(&["plot", run]);
    assert!(std::fs::read(folder.join("learning_curve.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(std::fs::read_to_string(folder.join("learning_curve.svg")).unwrap().contains("seed 7"));
}

#[test]
fn invalid_film_options_are_rejected_in_one_line() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=1", "run.actors=1"]);
    let run = folder.to_str().unwrap();
    for (arguments, words) in [
        (&[run, "--frames", "0"][..], "--frames"),
        (&[run, "--every-secs", "0.01"], "the shortest interval is one step, 0.05 s"),
        (&[run, "--from-secs", "49.9"], "the episode from 0 s to 50.00 s"),
        (&["no/such/run"], "no/such/run is no run folder"),
    ] {
        let line = refused(&[&["film"], arguments].concat());
        assert!(line.contains(words), "{line}");
    }
    assert!(!folder.join("film.png").exists());
}

/// The return that a line such as `episode 2 (evaluation-4-2, seed 7): return -12.34, 1000 steps` prints.
fn printed_return(text: &str, episode: &str) -> String {
    let line = text.lines().find_map(|line| line.split_once(&format!("{episode}: return ")));
    let (_, rest) = line.unwrap_or_else(|| panic!("no {episode} in {text}"));
    rest.split(',').next().unwrap().to_owned()
}

/// Iteration and mean return of the run's last evaluation.
fn last_evaluation(folder: &Path) -> (serde_json::Value, serde_json::Value) {
    let metrics = std::fs::read_to_string(folder.join("metrics.jsonl")).unwrap();
    let last = metrics.lines().rfind(|line| line.contains("\"kind\":\"evaluation\"")).unwrap();
    let last: serde_json::Value = serde_json::from_str(last).unwrap();
    (last["iteration"].clone(), last["mean"].clone())
}

#[test]
fn a_runs_sampled_evaluation_is_that_of_eval_with_its_seed_and_changes_no_weights() {
    let runs = Runs::new();
    let (mean, sampled) = (runs.folder("mean"), runs.folder("sampled"));
    train(&mean, &["run.iterations=2"]);
    train(&sampled, &["run.iterations=2", "evaluation.sampled=true"]);
    assert_eq!(inspect(&mean), inspect(&sampled));
    let run = sampled.to_str().unwrap();
    let measured = succeeded(&["eval", run, "--episodes", "1", "--sampled", "7", "--json"]);
    let measured: serde_json::Value = serde_json::from_str(&measured).unwrap();
    assert_eq!(last_evaluation(&sampled), (2.into(), measured["return_mean"].clone()));
    assert_ne!(last_evaluation(&mean).1, last_evaluation(&sampled).1);
}

#[test]
fn an_episode_has_one_return_in_every_command() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=2", "run.actors=1"]);
    let run = folder.to_str().unwrap();
    let measured = succeeded(&["eval", run, "--episodes", "3", "--json"]);
    let measured: serde_json::Value = serde_json::from_str(&measured).unwrap();
    assert_eq!((&measured["seed"], &measured["iteration"]), (&7.into(), &2.into()));
    let returns: Vec<f64> =
        (0..3).map(|i| measured["episodes"][i]["return"].as_f64().unwrap()).collect();
    assert!(returns[0] != returns[1] && returns[1] != returns[2], "{returns:?}");
    let shown = |index: usize| format!("{:.2}", returns[index]);
    let name = |index: usize| {
        assert_eq!(measured["episodes"][index]["episode_id"], format!("evaluation-2-{index}"));
        format!("episode {index} (evaluation-2-{index}, seed 7)")
    };
    assert!(succeeded(&["eval", run, "--episodes", "3"]).contains(&shown(2)));
    let several = succeeded(&["record", run, "--episodes", "3"]);
    let chosen = succeeded(&["record", run, "--episode", "2"]);
    let filmed = succeeded(&["film", run, "--episode", "2", "--frames", "1"]);
    for (told, indices) in [(&several, 0..3), (&chosen, 2..3), (&filmed, 2..3)] {
        for index in indices {
            assert_eq!(printed_return(told, &name(index)), shown(index));
        }
    }
    let exported = succeeded(&["export", run, "--onnx", folder.join("onnx").to_str().unwrap()]);
    assert_eq!(printed_return(&exported, &name(0)), shown(0));
    // The run's own last evaluation has one episode.
    assert_eq!(last_evaluation(&folder), (2.into(), returns[0].into()));
}

#[test]
fn only_the_named_file_or_folder_is_created_never_the_folder_around_it() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=1", "run.actors=1"]);
    let (run, missing) = (folder.to_str().unwrap(), runs.folder("mising"));
    let inside = missing.join("new");
    let inside = inside.to_str().unwrap();
    for (arguments, option) in [
        (vec!["record", run, "--out", inside], "--out"),
        (vec!["film", run, "--out", inside], "--out"),
        (vec!["export", run, "--onnx", inside], "--onnx"),
        (vec!["plot", run, "--out", inside], "--out"),
        (vec!["tasks", "--picture", inside], "--picture"),
    ] {
        let why = format!("{option} {inside}: there is no folder {}; create", missing.display());
        let line = refused(&arguments);
        assert!(line.contains(&why), "{line}");
        assert!(!missing.exists(), "{arguments:?}");
    }
    assert!(refused(&["record", run, "--out", run]).contains("is a folder; name a file"));
    let made = runs.folder("made");
    succeeded(&["export", run, "--onnx", made.to_str().unwrap()]);
    succeeded(&["plot", run, "--out", made.to_str().unwrap()]);
    assert!(made.join("agent_0.onnx").is_file() && made.join("learning_curve.png").is_file());
}

#[test]
fn a_killed_actor_is_replaced() {
    let runs = Runs::new();
    let dir = format!("run.dir={}", runs.folder("killed").display());
    let more = [dir.as_str(), "run.iterations=30", "run.actors=1"];
    let mut child = Command::new(env!("CARGO_BIN_EXE_s2mia"))
        .args([&["train"], TINY, &more].concat())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    // The run, the URL of its page, and its first iteration.
    lines.by_ref().take(3).for_each(|line| drop(line.unwrap()));
    let actors = children(child.id());
    assert_eq!(actors.len(), 1);
    signal(actors[0], "-KILL");
    let rest: Vec<String> = lines.map(Result::unwrap).collect();
    let output = child.wait_with_output().unwrap();
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{rest:?}\n{log}");
    assert!(log.contains("starting another in its place"), "{rest:?}\n{log}");
}
