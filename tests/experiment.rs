//! Whole experiments with real processes: stopped, killed and gone on with, they end in the same weights, and one
//! run that fails does not stop the others.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/experiments.rs"]
mod experiments;

use std::path::Path;

use experiments::{Experiment, s2mia};

#[test]
fn an_experiment_ends_in_a_table_and_figures_and_runs_nothing_twice() {
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
    assert_eq!(listed.matches("  finished").count(), 3, "{listed}");
}

#[test]
fn an_experiment_that_was_stopped_or_killed_ends_in_the_same_weights() {
    let whole = Experiment::new();
    whole.run();
    for signal in ["TERM", "KILL"] {
        let experiment = Experiment::new();
        let (status, told) = experiment.end_after_its_first_run(signal);
        assert_eq!(status, (signal == "TERM").then_some(0), "{told}");
        assert_eq!(told.contains("go on by `s2mia experiment"), signal == "TERM", "{told}");
        let told = experiment.run();
        assert!(told.contains("3 of 3 runs are finished"), "{told}");
        assert_eq!(experiment.hashes(), whole.hashes(), "{signal}");
    }
}

#[test]
fn a_run_whose_folder_holds_another_is_told_with_what_to_do_and_the_others_go_on() {
    let experiment = Experiment::new();
    let wrong = experiment.folder().join("cue-2x1-short-seed0");
    std::fs::create_dir_all(&wrong).unwrap();
    std::fs::write(wrong.join("config.toml"), "no_such_key = 1\n").unwrap();
    let (status, told) = s2mia(&["experiment", experiment.file()]);
    assert_eq!(status, Some(1), "{told}");
    assert!(
        told.contains("cue-2x1-short-seed0 cannot begin: ") && told.contains("`no_such_key`"),
        "{told}"
    );
    assert!(told.contains("2 of 3 runs are finished"), "{told}");
    let what_to_do = "the folders of 1 of 3 runs hold other runs; remove those, or give the \
                      experiment another `folder`";
    assert!(told.contains(what_to_do) && !told.contains("tries them again"), "{told}");
}

#[test]
fn the_experiments_of_the_repository_list_what_they_would_run() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/experiments");
    for (name, last) in [
        ("paper.toml", "720 runs, 7,200,000,000 steps"),
        ("paper-small.toml", "66 runs, 63,300,000 steps"),
    ] {
        let (status, told) = s2mia(&["experiment", folder.join(name).to_str().unwrap(), "--list"]);
        assert_eq!(status, Some(0), "{told}");
        assert!(told.lines().last().unwrap().starts_with(last), "{told}");
    }
}
