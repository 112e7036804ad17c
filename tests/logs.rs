//! Trajectory logs of real runs are complete and do not affect results; their tools exit with the right status.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/runs.rs"]
mod runs;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use runs::{Runs, inspect, s2mia, succeeded, train};

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

fn files(folder: &Path, kind: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == kind));
    paths.sort();
    paths
}

fn logs(folder: &Path) -> Vec<PathBuf> {
    files(&folder.join("logs"), "mcap")
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
    assert!(closing.contains("with intrinsic rewards of 16; "), "{closing}");
    assert!(closing.contains("0 shares lost, 0 files not finished"), "{closing}");
    let (status, text) = told(&log(&["verify".as_ref(), &folder.join("logs")]));
    assert_eq!(status, Some(0), "{text}");
    assert!(text.contains("7 episodes, 19 shares, 3,320 steps"), "{text}");
    // The run folder is accepted in place of its logs.
    let (status, text) = told(&log(&["replay".as_ref(), folder]));
    assert_eq!(status, Some(0), "{text}");
    assert!(text.contains("equal bit for bit"), "{text}");
}

#[test]
fn joined_logs_contain_whole_episodes() {
    let (runs, folder, _) = logged();
    let out = runs.folder("joined.mcap");
    let (status, text) =
        told(&log(&["join".as_ref(), &folder.join("logs"), "--out".as_ref(), &out]));
    assert_eq!(status, Some(0), "{text}");
    let told_of =
        "7 episodes, 19 shares, 3,320 steps; intrinsic rewards of 16 of 16 training shares";
    assert!(text.contains(told_of), "{text}");
    let text = succeeded(&["log", "info", out.to_str().unwrap()]);
    for part in
        ["task                 halfcheetah-6x1", "/tf", "/agents/5", "3,320", "joined_files"]
    {
        assert!(text.contains(part), "{part} is not in:\n{text}");
    }
    let (status, text) = told(&log(&["verify".as_ref(), &out]));
    assert_eq!(status, Some(0), "{text}");
    assert!(text.contains("intrinsic rewards of 16 of 16 training shares"), "{text}");
}

#[test]
fn a_resumed_run_logs_the_same_intrinsic_rewards() {
    let (runs, folder, _) = logged();
    let resumed = runs.folder("resumed");
    // Every second episode of an environment, and every second environment.
    train(&resumed, &["run.iterations=2", "log.episodes=2"]);
    let text = resumed.to_str().unwrap();
    succeeded(&["train", "--resume", text, "run.iterations=4", "log.episodes=all"]);
    let lines = |folder: &Path, start: u32| {
        let path = folder.join(format!("logs/rewards-{start:04}.jsonl"));
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(str::to_owned).collect::<BTreeSet<_>>()
    };
    let (whole, first, second) = (lines(folder, 1), lines(&resumed, 1), lines(&resumed, 2));
    assert_eq!((whole.len(), first.len(), second.len()), (16, 4, 8));
    assert!(first.is_subset(&whole) && second.is_subset(&whole));
    let (status, text) = told(&log(&["verify".as_ref(), &resumed.join("logs")]));
    assert_eq!(status, Some(3), "not every step is logged: {text}");
    assert!(text.contains("intrinsic rewards of 12 of 12 training shares"), "{text}");
}

#[test]
fn separate_folders_of_learner_and_actors_can_be_joined() {
    let (runs, folder, _) = logged();
    let (rewards, trajectories) = (runs.folder("of_learner"), runs.folder("of_actors"));
    for (to, extension) in [(&rewards, "jsonl"), (&trajectories, "mcap")] {
        std::fs::create_dir(to).unwrap();
        for path in files(&folder.join("logs"), extension) {
            std::fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
        }
    }
    let out = runs.folder("of_both.mcap");
    let (status, text) =
        told(&log(&["join".as_ref(), &rewards, &trajectories, "--out".as_ref(), &out]));
    assert_eq!(status, Some(0), "{text}");
    assert!(text.contains("intrinsic rewards of 16 of 16 training shares"), "{text}");
    let (status, text) = told(&log(&["replay".as_ref(), &rewards]));
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("no trajectories-*.mcap in"), "{text}");
}

#[test]
fn a_damaged_line_of_rewards_is_reported_and_only_its_share_is_lost() {
    let (runs, folder, _) = logged();
    let damaged = runs.folder("rewards-0009.jsonl");
    let text = std::fs::read_to_string(folder.join("logs/rewards-0001.jsonl")).unwrap();
    let (first, rest) = text.split_once('\n').unwrap();
    std::fs::write(&damaged, format!("{}\n{rest}", first.replacen("0.0", "0.1", 1))).unwrap();
    let part = "1 damaged lines, first line 1: the checksum does not match the content";
    let all = logs(folder);
    let paths: Vec<&Path> = all.iter().map(PathBuf::as_path).chain([&*damaged]).collect();
    let (status, text) = told(&log(&[&["verify".as_ref()], &paths[..]].concat()));
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains(part), "{text}");
    let out = runs.folder("without_one.mcap");
    let (status, text) =
        told(&log(&[&["join".as_ref(), "--out".as_ref(), &*out], &paths[..]].concat()));
    assert_eq!(status, Some(3), "{text}");
    assert!(text.contains("rewards of 15 of 16") && text.contains(part), "{text}");
}

#[test]
fn reward_logs_without_trajectory_logs_are_rejected_in_one_line() {
    let (_, folder, _) = logged();
    let alone = folder.join("logs/rewards-0001.jsonl");
    let (status, text) = told(&log(&["verify".as_ref(), &alone]));
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("name the trajectory logs") && text.lines().count() == 1, "{text}");
    let (status, text) = told(&log(&["info".as_ref(), &alone]));
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("is a reward log") && text.lines().count() == 1, "{text}");
}

#[test]
fn a_truncated_log_is_recovered_with_a_status_that_reports_the_loss() {
    let (runs, folder, _) = logged();
    let whole = logs(folder).into_iter().next().unwrap();
    let (cut, out) = (runs.folder("cut.mcap"), runs.folder("saved.mcap"));
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let (status, text) = told(&log(&["info".as_ref(), &cut]));
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("cut.mcap: not finished") && text.lines().count() == 1, "{text}");
    let (status, text) = told(&log(&["recover".as_ref(), &cut, "--out".as_ref(), &out]));
    assert_eq!(status, Some(3), "{text}");
    assert!(text.contains("lost: all data after the end"), "{text}");
    let (status, text) = told(&log(&["info".as_ref(), &out]));
    assert_eq!(status, Some(0), "{text}");
    let (status, text) = told(&log(&["recover".as_ref(), &cut, "--out".as_ref(), &cut]));
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("already exists"), "{text}");
    let again = runs.folder("again.mcap");
    let (status, text) = told(&log(&["recover".as_ref(), &whole, "--out".as_ref(), &again]));
    assert_eq!(status, Some(0), "{text}");
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
        for tool in ["info", "verify", "replay"] {
            let (found, text) = told(&log(&[tool.as_ref(), path]));
            assert_eq!(found, Some(status), "{text}");
            assert!(text.contains(part) && text.lines().count() == 1, "{text}");
        }
    }
    let (status, text) = told(&s2mia(&["actor", "--log-dir", "x", "--log-episodes", "some"]));
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("none, evaluation, all or a whole number"), "{text}");
}
