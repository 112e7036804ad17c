//! Trajectory logs of real runs are complete and do not affect results; their tools exit with the right status.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::runs::{Runs, inspect, json, outcome, s2mia, text, train};

/// Four iterations of two slots by two actors; evaluations before, between and after. An audit would log its slot again.
const FOUR: [&str; 3] = ["run.iterations=4", "run.actors=2", "audit.share=0"];

/// A run that logged all episodes, and its output.
fn logged() -> &'static (Runs, PathBuf, String) {
    static RUN: OnceLock<(Runs, PathBuf, String)> = OnceLock::new();
    RUN.get_or_init(|| {
        let runs = Runs::new();
        let folder = runs.folder("logged");
        let printed = train(&folder, &[&FOUR[..], &["log.episodes=all"]].concat());
        (runs, folder, printed)
    })
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
    let hash = |folder: &Path| json(&folder.join("manifest.json"))["config_sha256"].clone();
    assert_eq!(hash(&plain), hash(folder));
}

#[test]
fn every_step_of_the_run_is_logged_once_and_can_be_replayed() {
    let (_, folder, closing) = logged();
    // 4 x 80 steps of training, 3 evaluations of an episode of 1,000.
    assert!(closing.contains("logged 3,320 steps in 19 shares of episodes"), "{closing}");
    assert!(closing.contains("0 shares lost, 0 files not finished"), "{closing}");
    // The run folder is accepted in place of its logs.
    let (status, report) = outcome(s2mia(&["log", "--replay", text(folder)]));
    assert_eq!(status, Some(0), "{report}");
    for line in ["checksums and schemas are right", "equal bit for bit"] {
        assert_eq!(report.matches(line).count(), logs(folder).len(), "{report}");
    }
}

#[test]
fn files_that_are_no_whole_logs_are_rejected_in_one_line() {
    let (runs, folder, _) = logged();
    let cut = runs.folder("cut.mcap");
    let bytes = std::fs::read(&logs(folder)[0]).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let empty = runs.folder("empty");
    let recorded = runs.folder("recorded");
    for folder in [&empty, &recorded] {
        std::fs::create_dir(folder).unwrap();
    }
    std::fs::write(recorded.join("iter_00000020.mcap"), "").unwrap();
    for (path, status, parts) in [
        (text(&cut), 1, ["cut.mcap: not finished", "`mcap recover`"]),
        ("Cargo.toml", 1, ["Cargo.toml", "not an MCAP file"]),
        ("nowhere.mcap", 1, ["nowhere.mcap", "cannot read it"]),
        (text(&empty), 2, ["empty", "no trajectories-*.mcap"]),
        (text(&recorded), 2, ["recorded/iter_00000020.mcap for a recording", "; name a file such"]),
    ] {
        let (found, line) = outcome(s2mia(&["log", path]));
        assert_eq!(found, Some(status), "{line}");
        assert!(parts.iter().all(|part| line.contains(part)), "{line}");
        assert_eq!(line.lines().count(), 1, "{line}");
    }
    let whole = &logs(folder)[0];
    let (status, lines) = outcome(s2mia(&["log", text(&cut), "Cargo.toml", text(whole)]));
    assert_eq!((status, lines.lines().count()), (Some(1), 3), "{lines}");
    for part in ["cut.mcap: not finished", "not an MCAP file", "checksums and schemas are right"] {
        assert!(lines.contains(part), "files after a damaged one are checked: {lines}");
    }
    let mixed = runs.folder("mixed");
    std::fs::create_dir_all(mixed.join("trajectories-folder-0000.mcap")).unwrap();
    std::fs::copy(whole, mixed.join("trajectories-whole-0000.mcap")).unwrap();
    let (status, lines) = outcome(s2mia(&["log", text(&mixed)]));
    assert_eq!(status, Some(1));
    for part in ["it is a directory, not a plain file", "checksums and schemas are right"] {
        assert!(lines.contains(part), "files beside another thing are checked: {lines}");
    }
}
