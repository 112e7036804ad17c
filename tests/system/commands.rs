//! Commands that are refused, and commands in the background.

use std::io::{BufRead as _, BufReader, Lines};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};

use crate::runs::s2mia;

/// The one line on stderr with which a command is refused, with status 2.
pub(crate) fn refused(arguments: &[&str]) -> String {
    failed(arguments, 2)
}

/// The one line on stderr of a command that ends with `status` and prints nothing else.
pub(crate) fn failed(arguments: &[&str], status: i32) -> String {
    let output = s2mia(arguments);
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(status), "{arguments:?}: {line}");
    assert_eq!(line.lines().count(), 1, "{arguments:?}: {line}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
    line
}

/// A path as an argument.
pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

pub(crate) fn signal(process: u32, name: &str) {
    let sent = Command::new("kill").args([name, &process.to_string()]).status().unwrap();
    assert!(sent.success());
}

/// A process in the background and the lines of its standard output; dropping this value ends it.
pub(crate) struct Background {
    pub(crate) process: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Background {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
        Self::of(command.args(arguments).stderr(Stdio::null()))
    }

    pub(crate) fn of(command: &mut Command) -> Self {
        let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(process.stdout.take().unwrap()).lines();
        Self { process, lines }
    }

    /// The next line.
    pub(crate) fn line(&mut self) -> String {
        self.lines.next().unwrap().unwrap()
    }

    /// The last word of the next line, which is the URL of a process that has just begun to listen.
    pub(crate) fn url(&mut self) -> String {
        self.line().split_whitespace().last().unwrap().to_owned()
    }

    pub(crate) fn signal(&self, name: &str) {
        signal(self.process.id(), name);
    }

    /// Waits until the process ends with success; returns its other lines.
    pub(crate) fn rest(&mut self) -> Vec<String> {
        let lines = self.lines.by_ref().map(Result::unwrap).collect();
        assert!(self.process.wait().unwrap().success());
        lines
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // A process that has ended cannot be killed.
        let _killed = self.process.kill();
        let _reaped = self.process.wait();
    }
}
