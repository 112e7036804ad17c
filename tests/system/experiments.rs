//! A small experiment: two variants of a game, three runs, one of them much longer than the others.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

/// Runs `s2mia`; returns its exit status and output.
pub(crate) fn s2mia(arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_s2mia")).args(arguments).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(text).unwrap())
}

pub(crate) struct Experiment {
    directory: tempfile::TempDir,
    file: String,
}

impl Experiment {
    pub(crate) fn new() -> Self {
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

    pub(crate) fn file(&self) -> &str {
        &self.file
    }

    pub(crate) fn record(&self) -> PathBuf {
        self.directory.path().join("record.csv")
    }

    pub(crate) fn folder(&self) -> PathBuf {
        self.directory.path().join("runs")
    }

    /// Runs the experiment; returns its output.
    pub(crate) fn run(&self) -> String {
        let (status, output) = s2mia(&["experiment", &self.file, "--jobs", "2"]);
        assert_eq!(status, Some(0), "{output}");
        output
    }

    /// Runs the experiment and sends it the signal when its first run has finished, while the long one continues.
    pub(crate) fn end_after_its_first_run(&self, signal: &str) -> (Option<i32>, String) {
        let mut child = Command::new(env!("CARGO_BIN_EXE_s2mia"))
            .args(["experiment", &self.file, "--jobs", "2"])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap());
        let mut output = String::new();
        while !output.contains(" is finished\n") {
            assert!(lines.read_line(&mut output).unwrap() > 0, "{output}");
        }
        let id = child.id().to_string();
        assert!(Command::new("kill").args(["-s", signal, &id]).status().unwrap().success());
        lines.read_to_string(&mut output).unwrap();
        (child.wait().unwrap().code(), output)
    }

    /// The same for a part of the runs, alone; returns the exit status and the output.
    pub(crate) fn run_part(&self, part: &[&str]) -> (Option<i32>, String) {
        s2mia(&[&["experiment", &self.file, "--jobs", "1"], part].concat())
    }

    /// Starts a part of the runs.
    pub(crate) fn start_part(&self, part: &[&str]) -> Child {
        let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
        command.args(["experiment", &self.file, "--jobs", "1"]).args(part);
        command.stdout(Stdio::piped()).spawn().unwrap()
    }

    /// State hashes of all runs, in the order of their names.
    pub(crate) fn hashes(&self) -> Vec<String> {
        let names = ["cue-2x1-long-seed3", "cue-2x1-short-seed0", "cue-2x1-short-seed1"];
        let state = |name: &str| {
            let folder = self.folder().join(name);
            let (_, output) = s2mia(&["inspect", folder.to_str().unwrap(), "--json"]);
            let held: serde_json::Value = serde_json::from_str(&output).unwrap();
            held["state_sha256"].as_str().unwrap().to_owned()
        };
        names.map(state).to_vec()
    }
}
