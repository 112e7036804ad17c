//! A learner process without actors, with its output read as it is written.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

/// Settings of a small run of two iterations.
const RUN: &[&str] = &[
    "halfcheetah-2x3",
    "run.seed=7",
    "run.iterations=2",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.message_steps=10",
    "policy.encoder=8",
    "policy.hidden=8",
    "critic.width=16",
    "influence.encoder=8",
    "influence.hidden=8",
    "evaluation.every_steps=0",
];

fn s2mia(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(arguments);
    command
}

pub(crate) fn inspect(folder: &Path) -> serde_json::Value {
    let output = s2mia(&["inspect", folder.to_str().unwrap(), "--json"]).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A learner process and its URL.
pub(crate) struct Learner {
    pub(crate) process: Child,
    log: Arc<Mutex<String>>,
    reader: Option<JoinHandle<()>>,
    pub(crate) url: String,
}

impl Learner {
    pub(crate) fn start(folder: &Path, more: &[String]) -> Self {
        let dir = format!("run.dir={}", folder.display());
        let more = more.iter().map(String::as_str).collect::<Vec<_>>();
        let arguments =
            [&["learner", "--listen=127.0.0.1:0"], RUN, &[dir.as_str()], more.as_slice()].concat();
        let mut process =
            s2mia(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let log = Arc::new(Mutex::new(String::new()));
        let (lines, stderr) = (Arc::clone(&log), process.stderr.take().unwrap());
        let read = move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                lines.lock().unwrap().push_str(&format!("{line}\n"));
            }
        };
        let reader = std::thread::Builder::new().name("log".into()).spawn(read).unwrap();
        let mut first = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut first).unwrap();
        let url = first.split_whitespace().last().unwrap().to_owned();
        Self { process, log, reader: Some(reader), url }
    }

    /// Lets a valid actor do all the work; returns the log.
    pub(crate) fn finish(&mut self, actor: &[String]) -> String {
        let more = actor.iter().map(String::as_str);
        let arguments = ["actor", "--learner", &self.url].into_iter().chain(more);
        let output = s2mia(&arguments.collect::<Vec<_>>()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        self.wait()
    }

    /// Waits until the run is done; returns the log.
    pub(crate) fn wait(&mut self) -> String {
        let status = self.process.wait().unwrap();
        self.reader.take().unwrap().join().unwrap();
        let log = self.log();
        assert!(status.success(), "{log}");
        log
    }

    /// Stops the learner early; returns the log.
    pub(crate) fn stop(&mut self) -> String {
        let asked = Command::new("kill").arg(self.process.id().to_string()).status().unwrap();
        assert!(asked.success());
        self.wait()
    }

    /// The log so far.
    pub(crate) fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }
}

impl Drop for Learner {
    fn drop(&mut self) {
        // The learner still runs only if the test failed.
        let _killed = self.process.kill();
    }
}
