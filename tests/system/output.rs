//! Output that cannot be written: a full disk is an error, a reader that has gone ends a command that only prints.

use std::fs::File;
use std::io::{PipeWriter, pipe};
use std::process::Stdio;

use crate::processes::until;
use crate::runs::{Runs, command, error, inspect, text, tiny, train};

/// A pipe whose reader has gone.
fn unread() -> PipeWriter {
    pipe().unwrap().1
}

#[test]
fn a_full_disk_is_an_error_of_one_line_for_every_command_that_prints() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=1"]);
    let run = text(&folder);
    for arguments in [
        &["eval", run, "--episodes", "1", "--json"][..],
        &["inspect", run],
        &["status", run, "--json"],
        &["watch", run],
        &["export", run, "--onnx", text(&runs.folder("onnx"))],
        &["config", "cue-2x1"],
        &["tasks", "--json"],
        &["train", "--resume", run, "run.iterations=2"],
        &["--help"],
        &["--version"],
    ] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = command(arguments).stdout(full).stderr(Stdio::piped()).output().unwrap();
        let expected =
            "error: cannot write to standard output: No space left on device (os error 28)\n";
        assert_eq!((output.status.code(), &*error(&output)), (Some(1), expected), "{arguments:?}");
    }
    assert_eq!(inspect(&folder)["iteration"], 2);
}

#[test]
fn a_reader_that_has_gone_changes_no_status() {
    for (arguments, status) in [
        (&["--help"][..], 0),
        (&["--version"], 0),
        (&["eval", "--help"], 0),
        (&["config"], 0),
        (&["tasks"], 0),
        (&["inspect", "no/such/run"], 2),
        (&["dance"], 2),
        (&[], 2),
    ] {
        let ended = command(arguments).stdout(unread()).stderr(unread()).status().unwrap();
        assert_eq!(ended.code(), Some(status), "{arguments:?}");
    }
}

#[test]
fn a_watch_that_nobody_reads_ends_and_the_run_continues() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let endless = ["run.iterations=1000000", "--stop-with-stdin", "--page=off"];
    // Its own output is not read, either.
    let mut training = tiny("train", &folder, &endless);
    let mut training = training.stdin(Stdio::piped()).stdout(unread()).spawn().unwrap();
    until("there is a checkpoint", || folder.join("checkpoints/LATEST").is_file());
    let mut watch = command(&["watch", text(&folder)]);
    let watched = watch.stdout(unread()).stderr(Stdio::null()).status().unwrap();
    assert_eq!(watched.code(), Some(0));
    assert_eq!(training.try_wait().unwrap(), None);
    drop(training.stdin.take());
    assert_eq!(training.wait().unwrap().code(), Some(0));
}
