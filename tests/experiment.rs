//! Whole experiments with real processes: stopped, killed and resumed, they end with the same weights, and a failed
//! run does not stop the others.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/experiments.rs"]
mod experiments;

use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use experiments::{Experiment, s2mia};

/// State hashes of the runs of an undisturbed experiment.
fn undisturbed() -> &'static [String] {
    static HASHES: OnceLock<Vec<String>> = OnceLock::new();
    HASHES.get_or_init(|| {
        let experiment = Experiment::new();
        experiment.run();
        experiment.hashes()
    })
}

/// The rows of the printed table.
fn table(told: &str) -> Vec<&str> {
    told.lines().filter(|line| line.starts_with('|')).collect()
}

#[test]
fn an_experiment_records_its_runs_writes_a_table_and_figures_and_repeats_nothing_without_folders() {
    let experiment = Experiment::new();
    let told = experiment.run();
    assert!(
        told.contains("3 of 3 runs are finished") && told.contains("| cue-2x1 | short | 2 |"),
        "{told}"
    );
    let names =
        ["results.md", "results.csv", "learning_curve.png", "learning_curve.svg", "ablation.png"];
    for name in names {
        assert!(experiment.folder().join(name).is_file(), "{name}");
    }
    let results = std::fs::read_to_string(experiment.folder().join("results.csv")).unwrap();
    std::fs::remove_file(experiment.folder().join("results.csv")).unwrap();
    let (status, report) = s2mia(&["experiment", experiment.file(), "--report"]);
    assert_eq!(status, Some(0), "{report}");
    assert_eq!(std::fs::read_to_string(experiment.folder().join("results.csv")).unwrap(), results);

    let record = std::fs::read_to_string(experiment.record()).unwrap();
    let lines = experiment.folder().join("cue-2x1-long-seed3/provenance.jsonl");
    let lines = std::fs::read_to_string(lines).unwrap();
    let last: serde_json::Value = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
    let weights = last["weights_sha256"].as_str().unwrap();
    let of_long = |line: &&str| line.starts_with("cue-2x1,long,3,40000,") && line.contains(weights);
    assert_eq!(record.lines().filter(of_long).count(), 1, "{record}");
    std::fs::remove_dir_all(experiment.folder()).unwrap();
    let (_, listed) = s2mia(&["experiment", experiment.file(), "--list"]);
    assert_eq!(listed.matches("  recorded").count(), 3, "{listed}");
    let again = experiment.run();
    assert!(again.contains("3 of 3 runs are finished"), "{again}");
    assert!(!again.contains(" is finished\n"), "{again}");
    assert_eq!(table(&again), table(&told));
    assert_eq!(std::fs::read_to_string(experiment.record()).unwrap(), record);
}

#[test]
fn a_stopped_or_killed_experiment_ends_with_the_same_weights() {
    for signal in ["TERM", "KILL"] {
        let experiment = Experiment::new();
        let (status, told) = experiment.end_after_its_first_run(signal);
        assert_eq!(status, (signal == "TERM").then_some(0), "{told}");
        assert_eq!(told.contains("resume with `s2mia experiment"), signal == "TERM", "{told}");
        let told = experiment.run();
        assert!(told.contains("3 of 3 runs are finished"), "{told}");
        assert_eq!(experiment.hashes(), undisturbed(), "{signal}");
    }
}

#[test]
fn a_shard_that_is_stopped_resumes_and_all_shards_together_make_the_report() {
    let experiment = Experiment::new();
    let (status, told) = experiment.run_part(&["--only", "3"]);
    assert_eq!(status, Some(2), "{told}");
    let (status, told) = experiment.run_part(&["--shard", "0/2"]);
    assert_eq!((status, told.matches(" is finished\n").count()), (Some(0), 2), "{told}");
    assert!(told.contains("2 of 2 selected runs are finished; when all runs are"), "{told}");
    assert!(!experiment.folder().join("results.md").exists());
    let process = experiment.start_part(&["--shard", "1/2"]);
    let begun = experiment.folder().join("cue-2x1-long-seed3/metrics.jsonl");
    while !begun.exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    // A cluster signals all processes of a job, and the job's script passes the signal on.
    for _ in 0..2 {
        let id = process.id().to_string();
        assert!(Command::new("kill").args(["-s", "TERM", &id]).status().unwrap().success());
    }
    let output = process.wait_with_output().unwrap();
    let told = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{told}");
    let resume = format!("resume with `s2mia experiment {} --shard 1/2`", experiment.file());
    assert!(told.contains(&resume), "{told}");
    let (status, told) = experiment.run_part(&["--only", "1"]);
    assert_eq!(status, Some(0), "{told}");
    assert!(told.contains("3 of 3 runs are finished"), "{told}");
    assert!(experiment.folder().join("results.md").exists());
    assert_eq!(experiment.hashes(), undisturbed());
}

#[test]
fn a_dry_run_prints_the_script_of_the_job_array_and_writes_nothing() {
    let experiment = Experiment::new();
    let slurm = ["--submit", "slurm", "--time", "4:00:00", "--dry-run"];
    let (status, script) = s2mia(&[&["experiment", experiment.file()], &slurm[..]].concat());
    assert_eq!(status, Some(0), "{script}");
    assert!(script.starts_with("#!/bin/bash\n") && script.contains("--array=0-2\n"), "{script}");
    assert!(script.contains(&format!("experiment '{}' --shard", experiment.file())), "{script}");
    assert!(!experiment.folder().exists());
    let checked = Command::new("bash").args(["-n", "-c", &script]).status().unwrap();
    assert!(checked.success());
}

#[test]
fn a_host_without_slurm_and_an_option_of_the_other_engine_are_refused_in_one_line() {
    let experiment = Experiment::new();
    for (engine, option, words) in [
        ("slurm", "--runs-per-job=2", "sbatch is not installed on this host; run the command on"),
        ("slurm", "--queue=q", "--queue is an option of --submit k8s"),
        ("k8s", "--time=1", "--time is an option of --submit slurm"),
        ("k8s", "--dry-run", "--dry-run is an option of --submit slurm"),
        ("k8s", "--array-limit=2", "does not exist in a pod; --submit k8s needs a relative path"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_s2mia"))
            .args(["experiment", experiment.file(), "--submit", engine, option])
            .env("PATH", "")
            .output()
            .unwrap();
        let told = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{told}");
        assert!(told.contains(words) && told.lines().count() == 1, "{told}");
        assert!(!experiment.folder().exists());
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

/// A run in a record is found by the hash of its settings, which a renamed setting or a changed default would change.
#[test]
fn the_experiments_of_the_repository_list_their_runs_and_find_the_finished_ones_recorded() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/experiments");
    for (name, all, recorded) in [
        ("paper.toml", "720 runs, 7,200,000,000 steps", 0),
        ("study-second-round.toml", "90 runs, 90,000,000 steps", 90),
        ("study-terms.toml", "60 runs, 60,000,000 steps", 60),
        ("study-mappo.toml", "207 runs, 207,000,000 steps", 207),
        ("study-maddpg.toml", "9 runs, 2,700,000 steps", 6),
        ("study-k-nearest.toml", "30 runs, 18,000,000 steps", 30),
        ("study-preset-paper.toml", "18 runs, 18,000,000 steps", 18),
        ("study.toml", "180 runs, 180,000,000 steps", 180),
        ("study-mujoco.toml", "117 runs, 117,000,000 steps", 15),
        ("tuning.toml", "36 runs, 7,560,000 steps", 36),
        ("tuning-million.toml", "16 runs, 16,000,000 steps", 16),
        ("tuning-terms.toml", "90 runs, 27,000,000 steps", 90),
        ("signal.toml", "90 runs, 18,000,000 steps", 90),
    ] {
        let (status, told) = s2mia(&["experiment", folder.join(name).to_str().unwrap(), "--list"]);
        assert_eq!(status, Some(0), "{told}");
        assert!(told.lines().last().unwrap().starts_with(all), "{told}");
        let found = told.lines().filter(|line| line.ends_with(" recorded")).count();
        assert_eq!(found, recorded, "{name}: {told}");
    }
}
