//! Processes in the background, and waiting for what they do.

use std::io::{BufRead as _, BufReader, Lines};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::NamedTempFile;

use crate::runs::{command, metrics, succeeded, tiny};

/// Time between two polls; the other processes need the processor.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Polls `check` for up to 30 s; then panics with its error.
pub(crate) fn eventually<T>(mut check: impl FnMut() -> Result<T, String>) -> T {
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        match check() {
            Ok(answer) => return answer,
            Err(error) => assert!(Instant::now() < deadline, "{error}, after 30 s"),
        }
        std::thread::sleep(POLL_INTERVAL);
    }
}

/// Waits until `check` holds.
pub(crate) fn until(what: &str, mut check: impl FnMut() -> bool) {
    eventually(|| if check() { Ok(()) } else { Err(format!("not yet: {what}")) });
}

/// Waits until the run has finished more than `iteration` iterations.
pub(crate) fn passes(folder: &Path, iteration: usize) {
    eventually(|| match metrics(folder, "iteration").len() {
        now if now > iteration => Ok(()),
        now => Err(format!("{now} iterations are finished, {} are expected", iteration + 1)),
    });
}

/// Waits for the first iteration of a run.
pub(crate) fn has_begun(folder: &Path) {
    passes(folder, 0);
}

pub(crate) fn signal(process: u32, name: &str) {
    let sent = Command::new("kill").args([name, &process.to_string()]).status().unwrap();
    assert!(sent.success());
}

/// The `count` processes started by `parent`, once all are there, from the fourth field of their `stat`.
pub(crate) fn children(parent: u32, count: usize) -> Vec<u32> {
    let parent_of = |id: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse::<u32>().ok()
    };
    eventually(|| {
        let processes = std::fs::read_dir("/proc").unwrap();
        let ids = processes.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
        let found: Vec<u32> = ids.filter(|id| parent_of(id) == Some(parent)).collect();
        if found.len() >= count { Ok(found) } else { Err(format!("{found:?} of {count}")) }
    })
}

/// A process in the background, the lines of its standard output, and its log; dropping this value ends it.
pub(crate) struct Background {
    pub(crate) process: Child,
    lines: Lines<BufReader<ChildStdout>>,
    log: NamedTempFile,
}

impl Background {
    pub(crate) fn start(command: &mut Command) -> Self {
        let log = NamedTempFile::new().unwrap();
        let output = command.stdout(Stdio::piped()).stderr(log.reopen().unwrap());
        let mut process = output.spawn().unwrap();
        let lines = BufReader::new(process.stdout.take().unwrap()).lines();
        Self { process, lines, log }
    }

    /// The next line.
    pub(crate) fn line(&mut self) -> String {
        self.lines.next().unwrap_or_else(|| panic!("no line: {}", self.log())).unwrap()
    }

    /// The last word of the next line, which is the URL of a process that has just begun to listen.
    pub(crate) fn url(&mut self) -> String {
        self.line().split_whitespace().last().unwrap().to_owned()
    }

    /// Standard error so far.
    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(self.log.path()).unwrap()
    }

    /// Waits until the log contains `words` `count` times.
    pub(crate) fn logs(&self, words: &str, count: usize) {
        eventually(|| match self.log() {
            log if log.matches(words).count() >= count => Ok(()),
            log => Err(format!("`{words}` is not there {count} times: {log}")),
        });
    }

    pub(crate) fn signal(&self, name: &str) {
        signal(self.process.id(), name);
    }

    pub(crate) fn is_running(&mut self) -> bool {
        self.process.try_wait().unwrap().is_none()
    }

    /// Waits until the process ends; returns its exit status and its other lines.
    pub(crate) fn end(&mut self) -> (Option<i32>, Vec<String>) {
        let lines = self.lines.by_ref().map(Result::unwrap).collect();
        (self.process.wait().unwrap().code(), lines)
    }

    /// Waits until the process ends with success; returns its other lines.
    pub(crate) fn rest(&mut self) -> Vec<String> {
        let (status, lines) = self.end();
        assert_eq!(status, Some(0), "{lines:?}\n{}", self.log());
        lines
    }

    /// Asks the process to end, which it does with success; returns its log.
    pub(crate) fn stop(&mut self) -> String {
        self.signal("-TERM");
        self.rest();
        self.log()
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // A process that has ended cannot be killed.
        let _killed = self.process.kill();
        let _reaped = self.process.wait();
    }
}

/// The learner of a tiny run, and its URL.
pub(crate) struct Learner {
    pub(crate) process: Background,
    pub(crate) url: String,
}

impl Learner {
    /// Starts a learner on a free port.
    pub(crate) fn start(folder: &Path, more: &[&str]) -> Self {
        Self::at("127.0.0.1:0", folder, more)
    }

    /// Starts a learner and waits until it is ready for actors.
    pub(crate) fn at(address: &str, folder: &Path, more: &[&str]) -> Self {
        let listen = format!("--listen={address}");
        let mut command = tiny("learner", folder, &[&[listen.as_str()], more].concat());
        let mut process = Background::start(&mut command);
        let url = process.url();
        Self { process, url }
    }

    /// Lets a valid actor do all the work; returns the learner's log.
    pub(crate) fn finish(&mut self, actor: &[&str]) -> String {
        succeeded(&[&["actor", "--learner", &self.url], actor].concat());
        self.process.rest();
        self.process.log()
    }
}

/// An actor in the background.
pub(crate) fn actor(url: &str, more: &[&str]) -> Background {
    Background::start(command(&["actor", "--learner", url]).args(more))
}
