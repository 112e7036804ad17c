//! Trajectory logs of real runs are complete and do not affect results; their tools exit with the right status.

use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use crate::runs::{Runs, inspect, s2mia, train};

/// Four iterations of two slots by two actors; evaluations before, between and after. An audit would log its slot again.
const FOUR: [&str; 3] = ["run.iterations=4", "run.actors=2", "audit.share=0"];

/// A run that logged all episodes, and its output.
fn logged() -> &'static (Runs, PathBuf, String) {
    static RUN: OnceLock<(Runs, PathBuf, String)> = OnceLock::new();
    RUN.get_or_init(|| {
        let runs = Runs::new();
        let folder = runs.folder("logged");
        let told = train(&folder, &[&FOUR[..], &["log.episodes=all"]].concat());
        (runs, folder, told)
    })
}

fn log(arguments: &[&Path]) -> Output {
    let arguments: Vec<&str> = arguments.iter().map(|path| path.to_str().unwrap()).collect();
    s2mia(&[&["log"], arguments.as_slice()].concat())
}

fn told(output: &Output) -> (Option<i32>, String) {
    let text = [output.stdout.as_slice(), output.stderr.as_slice()].concat();
    (output.status.code(), String::from_utf8(text).unwrap())
}

fn logs(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder.join("logs")).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    paths.sort();
    paths
}

#[test]
fn logging_does_not_affect_the_run_or_the_hash_of_its_settings() {
    let (runs, folder, _) = logged();
    let plain = runs.folder("plain");
    train(&plain, &FOUR);
    assert_eq!(inspect(&plain), inspect(folder));
    assert!(logs(&plain).is_empty(), "there are logs without the option");
    let hash = |folder: &Path| {
        let text = std::fs::read_to_string(folder.join("manifest.json")).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).unwrap()["config_sha256"].clone()
    };
    assert_eq!(hash(&plain), hash(folder));
}

#[test]
fn every_step_of_the_run_is_logged_once_and_can_be_replayed() {
    let (_, folder, closing) = logged();
    // 4 x 80 steps of training, 3 evaluations of an episode of 1,000.
    assert!(closing.contains("logged 3,320 steps in 19 shares of episodes"), "{closing}");
    assert!(closing.contains("0 shares lost, 0 files not finished"), "{closing}");
    // The run folder is accepted in place of its logs.
    let (status, text) = told(&log(&["--replay".as_ref(), folder]));
    assert_eq!(status, Some(0), "{text}");
    let files = logs(folder).len();
    for line in ["checksums and schemas are right", "equal bit for bit"] {
        assert_eq!(text.matches(line).count(), files, "{text}");
    }
}

#[test]
fn a_truncated_log_is_refused_with_the_tool_that_saves_its_intact_part() {
    let (runs, folder, _) = logged();
    let whole = logs(folder).into_iter().next().unwrap();
    let cut = runs.folder("cut.mcap");
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let (status, text) = told(&log(&[&cut]));
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("cut.mcap: not finished") && text.contains("`mcap recover`"), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
}

#[test]
fn files_that_are_not_logs_are_rejected_in_one_line() {
    let (runs, ..) = logged();
    let folder = runs.folder("empty");
    std::fs::create_dir(&folder).unwrap();
    for (path, status, part) in [
        (Path::new("Cargo.toml"), 1, "not an MCAP file"),
        (Path::new("nowhere.mcap"), 1, "cannot read it"),
        (&folder, 2, "no trajectories-*.mcap"),
    ] {
        let (found, text) = told(&log(&[path]));
        assert_eq!(found, Some(status), "{text}");
        assert!(text.contains(part) && text.lines().count() == 1, "{text}");
    }
    let (status, text) = told(&s2mia(&["actor", "--log-dir", "x", "--log-episodes", "some"]));
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("none, evaluation, all or a whole number"), "{text}");
}
