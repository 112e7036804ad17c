//! Whole experiments with real processes: stopped, killed and resumed, they end with the same weights, and a failed
//! run does not stop the others.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/experiments.rs"]
mod experiments;

use std::path::Path;

use experiments::{Experiment, s2mia};

#[test]
fn an_experiment_writes_a_table_and_figures_and_runs_nothing_twice() {
    let experiment = Experiment::new();
    let told = experiment.run();
    assert!(
        told.contains("3 of 3 runs are finished") && told.contains("| cue-2x1 | short | 2 |"),
        "{told}"
    );
    for name in
        ["results.md", "results.csv", "learning_curve.png", "learning_curve.svg", "ablation.png"]
    {
        assert!(experiment.folder().join(name).is_file(), "{name}");
    }
    let table = std::fs::read_to_string(experiment.folder().join("results.csv")).unwrap();
    let again = experiment.run();
    assert!(!again.contains(" is finished\n"), "{again}");
    std::fs::remove_file(experiment.folder().join("results.csv")).unwrap();
    let (status, told) = s2mia(&["experiment", experiment.file(), "--report"]);
    assert_eq!(status, Some(0), "{told}");
    assert_eq!(std::fs::read_to_string(experiment.folder().join("results.csv")).unwrap(), table);
    let (_, listed) = s2mia(&["experiment", experiment.file(), "--list"]);
    assert_eq!(listed.matches("  recorded").count(), 3, "{listed}");
}

#[test]
fn recorded_runs_are_compared_and_not_repeated_without_their_folders() {
    let experiment = Experiment::new();
    let table = |told: &str| {
        told.lines().filter(|line| line.starts_with('|')).collect::<Vec<_>>().join("\n")
    };
    let first = table(&experiment.run());
    let record = std::fs::read_to_string(experiment.record()).unwrap();
    let state = experiment.folder().join("cue-2x1-long-seed3/provenance.jsonl");
    let last = std::fs::read_to_string(state).unwrap();
    let last: serde_json::Value = serde_json::from_str(last.lines().last().unwrap()).unwrap();
    let weights = last["weights_sha256"].as_str().unwrap();
    let of_long = |line: &&str| line.starts_with("cue-2x1,long,3,40000,") && line.contains(weights);
    assert_eq!(record.lines().filter(of_long).count(), 1, "{record}");
    std::fs::remove_dir_all(experiment.folder()).unwrap();
    let (_, listed) = s2mia(&["experiment", experiment.file(), "--list"]);
    assert_eq!(listed.matches("  recorded").count(), 3, "{listed}");
    let again = experiment.run();
    assert!(
        again.contains("3 of 3 runs are finished") && !again.contains(" is finished\n"),
        "{again}"
    );
    assert_eq!(table(&again), first);
    assert_eq!(std::fs::read_to_string(experiment.record()).unwrap(), record);
}

#[test]
fn a_stopped_or_killed_experiment_ends_with_the_same_weights() {
    let whole = Experiment::new();
    whole.run();
    for signal in ["TERM", "KILL"] {
        let experiment = Experiment::new();
        let (status, told) = experiment.end_after_its_first_run(signal);
        assert_eq!(status, (signal == "TERM").then_some(0), "{told}");
        assert_eq!(told.contains("resume with `s2mia experiment"), signal == "TERM", "{told}");
        let told = experiment.run();
        assert!(told.contains("3 of 3 runs are finished"), "{told}");
        assert_eq!(experiment.hashes(), whole.hashes(), "{signal}");
    }
}

#[test]
fn a_run_whose_folder_contains_another_run_fails_with_advice_and_the_others_continue() {
    let experiment = Experiment::new();
    let wrong = experiment.folder().join("cue-2x1-short-seed0");
    std::fs::create_dir_all(&wrong).unwrap();
    std::fs::write(wrong.join("config.toml"), "no_such_key = 1\n").unwrap();
    std::fs::write(wrong.join("manifest.json"), "{}\n").unwrap();
    let (status, told) = s2mia(&["experiment", experiment.file()]);
    assert_eq!(status, Some(1), "{told}");
    assert!(
        told.contains("cue-2x1-short-seed0 cannot begin: ") && told.contains("`no_such_key`"),
        "{told}"
    );
    assert!(told.contains("2 of 3 runs are finished"), "{told}");
    let what_to_do = "the folders of 1 of 3 runs hold other runs; remove those, or give the \
                      experiment another `folder`";
    assert!(told.contains(what_to_do) && !told.contains("retries them"), "{told}");
}

#[test]
fn the_experiments_of_the_repository_list_what_they_would_run() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/experiments");
    for (name, last) in [
        ("paper.toml", "720 runs, 7,200,000,000 steps"),
        ("study.toml", "90 runs, 90,000,000 steps"),
        ("study-terms.toml", "270 runs, 270,000,000 steps"),
        ("study-mappo.toml", "117 runs, 98,100,000 steps"),
        ("tuning.toml", "225 runs, 67,500,000 steps"),
    ] {
        let (status, told) = s2mia(&["experiment", folder.join(name).to_str().unwrap(), "--list"]);
        assert_eq!(status, Some(0), "{told}");
        assert!(told.lines().last().unwrap().starts_with(last), "{told}");
    }
}
