//! Whole experiments with real processes: stopped, killed and resumed, they end with the same weights, and a failed
//! run does not stop the others.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde_json::Value;

use crate::processes::{Background, until};
use crate::runs::{command, error, inspect, outcome, succeeded, text};

/// Options with which all runs are started, two at a time.
const ALL: [&str; 2] = ["--jobs", "2"];

/// In place of a signal: `s2mia stop` ends one run.
const STOP: &str = "stop";

/// A small experiment: two variants of a game, three runs, one of them much longer than the others.
struct Experiment {
    directory: tempfile::TempDir,
    file: String,
}

impl Experiment {
    fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let text = format!(
            r#"
            folder = "{folder}/runs"
            record = "{folder}/record.csv"
            env_steps = 2_000
            seeds = [0, 1]
            tasks = ["cue-2x1"]
            actors = 1
            threads = 1
            baseline = "short"
            threshold = 0.5
            settings.evaluation.every_steps = 1_000
            settings.evaluation.episodes = 1
            settings.checkpoint.every = 2

            [[variants]]
            name = "short"
            algorithm = "happo"

            [[variants]]
            name = "long"
            algorithm = "happo-s2mia"
            seeds = [3]
            env_steps = 40_000
            "#,
            folder = directory.path().display()
        );
        let file = directory.path().join("experiment.toml");
        std::fs::write(&file, text).unwrap();
        Self { file: file.to_str().unwrap().to_owned(), directory }
    }

    /// `s2mia experiment` with its file.
    fn command(&self, more: &[&str]) -> Command {
        command(&[&["experiment", &self.file], more].concat())
    }

    /// Runs the command with success; returns its output.
    fn run(&self, more: &[&str]) -> String {
        let (status, text) = outcome(self.command(more).output().unwrap());
        assert_eq!(status, Some(0), "{text}");
        text
    }

    fn record(&self) -> String {
        std::fs::read_to_string(self.directory.path().join("record.csv")).unwrap()
    }

    fn folder(&self) -> PathBuf {
        self.directory.path().join("runs")
    }

    /// Runs all and sends the signal when the first run has finished, while the long one continues; or stops that alone.
    fn end_after_its_first_run(&self, signal: &str) -> (Option<i32>, String) {
        let mut process = Background::start(&mut self.command(&ALL));
        while !process.line().ends_with(" is finished") {}
        if signal == STOP {
            succeeded(&["stop", text(&self.folder().join("cue-2x1-long-seed3"))]);
        } else {
            process.signal(signal);
        }
        let (status, lines) = process.end();
        (status, [lines.join("\n"), process.log()].concat())
    }

    /// State hashes of all runs, in the order of their names.
    fn hashes(&self) -> Vec<Value> {
        let names = ["cue-2x1-long-seed3", "cue-2x1-short-seed0", "cue-2x1-short-seed1"];
        let state = |name| inspect(&self.folder().join(name))["state_sha256"].clone();
        names.map(state).to_vec()
    }
}

/// State hashes of the runs of an undisturbed experiment.
fn undisturbed() -> &'static [Value] {
    static HASHES: OnceLock<Vec<Value>> = OnceLock::new();
    HASHES.get_or_init(|| {
        let experiment = Experiment::new();
        experiment.run(&ALL);
        experiment.hashes()
    })
}

/// The rows of the printed table.
fn table(printed: &str) -> Vec<&str> {
    printed.lines().filter(|line| line.starts_with('|')).collect()
}

#[test]
fn an_experiment_records_its_runs_writes_a_table_and_figures_and_repeats_nothing_without_folders() {
    let experiment = Experiment::new();
    let printed = experiment.run(&ALL);
    assert!(
        printed.contains("3 of 3 runs are finished") && printed.contains("| cue-2x1 | short | 2 |"),
        "{printed}"
    );
    for name in ["results.md", "learning_curve.png", "learning_curve.svg", "ablation.png"] {
        assert!(experiment.folder().join(name).is_file(), "{name}");
    }
    let results = std::fs::read_to_string(experiment.folder().join("results.md")).unwrap();
    std::fs::remove_file(experiment.folder().join("results.md")).unwrap();
    experiment.run(&["--report"]);
    assert_eq!(std::fs::read_to_string(experiment.folder().join("results.md")).unwrap(), results);

    let record = experiment.record();
    let lines = experiment.folder().join("cue-2x1-long-seed3/provenance.jsonl");
    let lines = std::fs::read_to_string(lines).unwrap();
    let last: Value = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
    let weights = last["weights_sha256"].as_str().unwrap();
    let of_long = |line: &&str| line.starts_with("cue-2x1,long,3,40000,") && line.contains(weights);
    assert_eq!(record.lines().filter(of_long).count(), 1, "{record}");
    let file = experiment.directory.path().join("record.csv");
    let other = record.replace("cue-2x1,short,0,2000,", "cue-2x1,short,0,2000,9");
    std::fs::write(&file, other).unwrap();
    let refused = error(&experiment.command(&["--report"]).output().unwrap());
    assert!(refused.contains("it has other results of cue-2x1-short-seed0 than"), "{refused}");
    std::fs::write(&file, &record).unwrap();
    std::fs::remove_dir_all(experiment.folder()).unwrap();
    let listed = experiment.run(&["--list"]);
    assert_eq!(listed.matches("  recorded").count(), 3, "{listed}");
    let again = experiment.run(&ALL);
    assert!(again.contains("3 of 3 runs are finished"), "{again}");
    assert!(!again.contains(" is finished\n"), "{again}");
    assert_eq!(table(&again), table(&printed));
    assert_eq!(experiment.record(), record);
}

#[test]
fn a_finished_run_that_lost_evaluations_is_named_and_left_out_and_one_without_a_manifest_is_mended()
{
    let experiment = Experiment::new();
    experiment.run(&ALL);
    let record = experiment.record();
    std::fs::remove_file(experiment.directory.path().join("record.csv")).unwrap();
    std::fs::remove_file(experiment.folder().join("cue-2x1-short-seed1/manifest.json")).unwrap();
    std::fs::remove_file(experiment.folder().join("cue-2x1-short-seed1/config.toml")).unwrap();
    let metrics = experiment.folder().join("cue-2x1-short-seed0/metrics.jsonl");
    let whole = std::fs::read_to_string(&metrics).unwrap();
    std::fs::write(&metrics, whole.lines().last().unwrap().to_owned() + "\n").unwrap();
    let (status, printed) = outcome(experiment.command(&ALL).output().unwrap());
    assert_eq!(status, Some(1), "{printed}");
    let why = "cue-2x1-short-seed0/metrics.jsonl has no evaluation at 0 steps: the report leaves this run out; restore the file";
    assert!(printed.contains(why) && printed.contains("2 of 3 runs are finished"), "{printed}");
    let seed0 = |line: &&str| !line.starts_with("cue-2x1,short,0,");
    assert!(experiment.record().lines().eq(record.lines().filter(seed0)));
    std::fs::write(&metrics, whole).unwrap();
    experiment.run(&["--report"]);
    assert_eq!(experiment.record(), record);

    let rows: Vec<&str> = record.lines().collect();
    std::fs::write(
        experiment.directory.path().join("record.csv"),
        rows[..rows.len() - 1].join("\n"),
    )
    .unwrap();
    let refused = experiment.command(&ALL).output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    let why = "the record of cue-2x1-short-seed1 has no last line, which has the hashes of a run; delete its lines";
    assert!(error(&refused).contains(why), "{}", error(&refused));
}

#[test]
fn a_stopped_or_killed_experiment_ends_with_the_same_weights() {
    for (signal, expected) in [("-TERM", Some(0)), ("-KILL", None), (STOP, Some(1))] {
        let experiment = Experiment::new();
        let (status, printed) = experiment.end_after_its_first_run(signal);
        assert_eq!(status, expected, "{printed}");
        assert_eq!(
            printed.contains("resume with `s2mia experiment"),
            signal == "-TERM",
            "{printed}"
        );
        assert_eq!(printed.contains("1 of 3 runs were stopped"), signal == STOP, "{printed}");
        // Each run has its own folder, whatever the environment says.
        let again = experiment.command(&ALL).env("S2MIA__RUN__DIR", "elsewhere").output().unwrap();
        let (status, printed) = crate::runs::outcome(again);
        assert!(status == Some(0) && printed.contains("3 of 3 runs are finished"), "{printed}");
        assert_eq!(experiment.hashes(), undisturbed(), "{signal}");
    }
}

#[test]
fn a_shard_that_is_stopped_resumes_and_all_shards_together_make_the_report() {
    let experiment = Experiment::new();
    let absent = experiment.command(&["--only", "3"]).output().unwrap();
    assert_eq!(absent.status.code(), Some(2), "{}", error(&absent));
    let one = ["--jobs", "1", "--shard"];
    let printed = experiment.run(&[&one[..], &["0/2"]].concat());
    assert_eq!(printed.matches(" is finished\n").count(), 2, "{printed}");
    assert!(printed.contains("2 of 2 selected runs are finished; when all runs are"), "{printed}");
    assert!(!experiment.folder().join("results.md").exists());
    let second = [&one[..], &["1/2"]].concat();
    let mut process = Background::start(&mut experiment.command(&second));
    let begun = experiment.folder().join("cue-2x1-long-seed3/metrics.jsonl");
    until("the run has begun", || begun.exists());
    // A cluster signals all processes of a job, and the job's script passes the signal on.
    process.signal("-TERM");
    process.signal("-TERM");
    let printed = process.rest().join("\n");
    let resume = format!("resume with `s2mia experiment {} --shard 1/2`", experiment.file);
    assert!(printed.contains(&resume), "{printed}");
    let printed = experiment.run(&["--only", "1"]);
    assert!(printed.contains("3 of 3 runs are finished"), "{printed}");
    assert!(experiment.folder().join("results.md").exists());
    assert_eq!(experiment.hashes(), undisturbed());
}

#[test]
fn a_dry_run_prints_the_script_of_the_job_array_and_writes_nothing() {
    let experiment = Experiment::new();
    let slurm = ["--submit", "slurm", "--time", "4:00:00", "--dry-run"];
    let script = experiment.run(&slurm);
    assert!(script.starts_with("#!/bin/bash\n") && script.contains("--array=0-2\n"), "{script}");
    assert!(script.contains(&format!("experiment '{}' --shard", experiment.file)), "{script}");
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
        let mut submit = experiment.command(&["--submit", engine, option]);
        let output = submit.env("PATH", "").output().unwrap();
        let line = error(&output);
        assert_eq!(output.status.code(), Some(2), "{line}");
        assert!(line.contains(words) && line.lines().count() == 1, "{line}");
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
    let (status, printed) = outcome(experiment.command(&[]).output().unwrap());
    assert_eq!(status, Some(1), "{printed}");
    assert!(
        printed.contains("cue-2x1-short-seed0 cannot begin: ") && printed.contains("`no_such_key`"),
        "{printed}"
    );
    assert!(printed.contains("2 of 3 runs are finished"), "{printed}");
    let what_to_do = "the folders of 1 of 3 runs hold runs with other settings; restore the settings, or give \
                      the experiment another `folder`";
    assert!(printed.contains(what_to_do) && !printed.contains("retries them"), "{printed}");
}

/// The finished runs in a record: the last row of each has the hash of its settings.
fn runs_in(record: &str) -> usize {
    let record = Path::new(env!("CARGO_MANIFEST_DIR")).join(record);
    let rows = std::fs::read_to_string(record).unwrap();
    let hash = |row: &str| !row.split(',').nth(7).unwrap().is_empty();
    rows.lines().skip(1).filter(|row| hash(row)).count()
}

/// A run in a record is found by the hash of its settings, which a renamed setting or a changed default would change.
#[test]
fn the_experiments_of_the_repository_list_their_runs_and_find_the_finished_ones_recorded() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/experiments");
    for (name, all, recorded) in [
        ("paper.toml", "720 runs, 7,200,000,000 steps", 0),
        ("study-second-round.toml", "90 runs, 90,000,000 steps", 90),
        ("study-jump.toml", "90 runs, 90,000,000 steps", 90),
        ("study-terms.toml", "60 runs, 60,000,000 steps", 60),
        ("study-mappo.toml", "207 runs, 207,000,000 steps", 207),
        ("study-maddpg.toml", "9 runs, 2,700,000 steps", 6),
        ("study-together.toml", "240 runs, 240,000,000 steps", 40),
        ("study-surprise.toml", "420 runs, 336,000,000 steps", 30),
        ("study-local.toml", "180 runs, 180,000,000 steps", 0),
        ("study-scale.toml", "36 runs, 360,000,000 steps", 0),
        ("study-k-nearest.toml", "30 runs, 18,000,000 steps", 30),
        ("study-preset-paper.toml", "18 runs, 18,000,000 steps", 18),
        ("study.toml", "180 runs, 180,000,000 steps", 180),
        ("study-hasac.toml", "20 runs, 2,000,000 steps", runs_in("docs/study-hasac.csv")),
        ("study-hasac-300k.toml", "20 runs, 6,000,000 steps", runs_in("docs/study-hasac-300k.csv")),
        ("study-hasac-ant.toml", "5 runs, 500,000 steps", runs_in("docs/study-hasac-ant.csv")),
        ("study-mujoco.toml", "117 runs, 117,000,000 steps", runs_in("docs/study-mujoco.csv")),
        (
            "study-mujoco-mappo.toml",
            "117 runs, 117,000,000 steps",
            runs_in("docs/study-mujoco.csv"),
        ),
        ("tuning.toml", "36 runs, 7,560,000 steps", 36),
        ("tuning-million.toml", "16 runs, 16,000,000 steps", 16),
        ("tuning-local.toml", "16 runs, 4,800,000 steps", 16),
        ("tuning-terms.toml", "90 runs, 27,000,000 steps", 90),
        ("worlds.toml", "38 runs, 38,000,000 steps", runs_in("docs/study-worlds.csv")),
        ("signal.toml", "90 runs, 18,000,000 steps", 90),
    ] {
        let printed = succeeded(&["experiment", text(&folder.join(name)), "--list"]);
        assert!(printed.lines().last().unwrap().starts_with(all), "{printed}");
        let found = printed.lines().filter(|line| line.ends_with(" recorded")).count();
        assert_eq!(found, recorded, "{name}: {printed}");
    }
}
