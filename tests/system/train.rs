//! Whole runs with real processes: policies learn, and every tool reads a run's files.

use std::path::Path;

use serde_json::Value;

use crate::runs::{
    Runs, command, evaluated, inspect, metrics, refused, succeeded, success, text, train,
};

/// Iteration and mean return of the run's last evaluation.
fn last_evaluation(folder: &Path) -> (Value, Value) {
    let last = metrics(folder, "evaluation").pop().unwrap();
    (last["iteration"].clone(), last["mean"].clone())
}

#[test]
fn games_are_learnt_that_untrained_policies_fail() {
    // Guessing the cue earns 50 / 9. Without communication, the best return of the signal is 33.7. The optimum is 50.
    for (task, settings) in [
        ("cue-2x1", ["algorithm=happo", "run.env_steps=30000"]),
        ("cue-2x1", ["algorithm=happo-s2mia", "run.env_steps=30000"]),
        ("signal-2x1", ["evaluation.every_steps=80000", "run.env_steps=80000"]),
    ] {
        let runs = Runs::new();
        let folder = runs.folder("run");
        let mut run = command(&["train", task, "run.seed=3", "run.actors=2"]);
        success(run.args(settings).arg(format!("run.dir={}", folder.display())));
        let (_, mean) = last_evaluation(&folder);
        assert!(mean.as_f64().unwrap() > 45.0, "{task} {settings:?}: {mean}");
        succeeded(&["record", text(&folder), "--out", text(&folder.join("game.mcap"))]);
    }
}

/// The return that a line such as `episode 2 (evaluation-4-2, seed 7): return -12.34, 1000 steps` prints.
fn printed_return(text: &str, episode: &str) -> String {
    let line = text.lines().find_map(|line| line.split_once(&format!("{episode}: return ")));
    let (_, rest) = line.unwrap_or_else(|| panic!("no {episode} in {text}"));
    rest.split(',').next().unwrap().to_owned()
}

#[test]
fn every_tool_reads_the_files_of_a_run_and_an_episode_has_one_return_in_all_of_them() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let printed = train(&folder, &["run.iterations=2", "run.actors=2"]);
    assert!(printed.contains("algorithm happo-s2mia, seed 7, 2 actors"), "{printed}");
    assert!(printed.contains("evaluation return"), "{printed}");
    let run = text(&folder);
    let measured = evaluated(run, &["--episodes", "3"]);
    assert_eq!((&measured["seed"], &measured["iteration"]), (&7.into(), &2.into()));
    let returns: Vec<f64> =
        (0..3).map(|i| measured["episodes"][i]["return"].as_f64().unwrap()).collect();
    assert!(returns[0] != returns[1] && returns[1] != returns[2], "{returns:?}");
    // The run's own last evaluation has one episode.
    assert_eq!(last_evaluation(&folder), (2.into(), returns[0].into()));
    let shown = |index: usize| format!("{:.2}", returns[index]);
    let name = |index: usize| {
        assert_eq!(measured["episodes"][index]["episode_id"], format!("evaluation-2-{index}"));
        format!("episode {index} (evaluation-2-{index}, seed 7)")
    };
    assert!(succeeded(&["eval", run, "--episodes", "3"]).contains(&shown(2)));
    let (mcap, onnx) = (folder.join("episode.mcap"), folder.join("onnx"));
    let filmed = succeeded(&["film", run, "--still", "--episode", "2", "--frames", "5"]);
    for (printed, indices) in [
        (&succeeded(&["record", run, "--episodes", "3"]), 0..3),
        (&succeeded(&["record", run, "--episode", "2", "--out", text(&mcap)]), 2..3),
        (&filmed, 2..3),
        (&succeeded(&["export", run, "--onnx", text(&onnx)]), 0..1),
    ] {
        for index in indices {
            assert_eq!(printed_return(printed, &name(index)), shown(index));
        }
    }
    assert!(std::fs::read(&mcap).unwrap().starts_with(b"\x89MCAP0\r\n"));
    assert!(
        filmed.contains("5 frames from 5.00 s to 5.20 s") && filmed.contains("m/s"),
        "{filmed}"
    );
    let film = std::fs::read(folder.join("film.png")).unwrap();
    assert!(film.starts_with(b"\x89PNG"));
    // Four frames of 480 pixels side by side, two rows of 270 with their times, six agents below.
    assert_eq!(film[16..24], [1980_u32.to_be_bytes(), 634_u32.to_be_bytes()].concat());
    succeeded(&["plot", run]);
    assert!(std::fs::read(folder.join("learning_curve.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(std::fs::read_to_string(folder.join("learning_curve.svg")).unwrap().contains("seed 7"));
}

#[test]
fn a_runs_sampled_evaluation_is_that_of_eval_with_its_seed_and_changes_no_weights() {
    let runs = Runs::new();
    let (mean, sampled) = (runs.folder("mean"), runs.folder("sampled"));
    train(&mean, &["run.iterations=2"]);
    train(&sampled, &["run.iterations=2", "evaluation.sampled=true"]);
    assert_eq!(inspect(&mean), inspect(&sampled));
    let measured = evaluated(text(&sampled), &["--episodes", "1", "--sampled", "7"]);
    assert_eq!(last_evaluation(&sampled), (2.into(), measured["return_mean"].clone()));
    assert_ne!(last_evaluation(&mean).1, last_evaluation(&sampled).1);
    let other = evaluated(text(&sampled), &["--episodes", "1", "--sampled", "8"]);
    assert_ne!(other["return_mean"], measured["return_mean"], "two sampling seeds");
}

#[test]
fn the_checkpoint_with_the_best_evaluation_stays_and_is_chosen_by_name() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=6", "checkpoint.keep_last=1"]);
    let run = text(&folder);
    let mean = |line: &Value| line["mean"].as_f64().unwrap();
    let after_training = metrics(&folder, "evaluation").into_iter().skip(1);
    let best = after_training.max_by(|a, b| mean(a).total_cmp(&mean(b))).unwrap();
    let measured = evaluated(run, &["--episodes", "1", "--checkpoint", "best"]);
    assert_eq!(measured["iteration"], best["iteration"]);
    assert_eq!(measured["return_mean"], best["mean"]);
    let newest = evaluated(run, &["--episodes", "1", "--checkpoint", "6"]);
    assert_eq!(newest, evaluated(run, &["--episodes", "1"]));
    let gone = refused(&["inspect", run, "--checkpoint", "3"]);
    assert!(gone.contains("has no checkpoint of iteration 3, only of "), "{gone}");
    let other = refused(&["eval", run, "--checkpoint", "newest"]);
    assert!(
        other.contains("`newest` is no checkpoint; name last, best, an iteration or"),
        "{other}"
    );
}
