//! Runs that start from trained policies.

use std::fs;

use proto::Digest;

use crate::runs::{
    Runs, command, failed, failure, inspect, metrics, refused, succeeded, success, text, tiny,
    train,
};
use crate::teams::TASK;

const FOUR: &str = "run.iterations=4";

#[test]
fn a_run_that_started_from_another_ends_with_the_same_bits_and_does_not_need_the_other_any_more() {
    let runs = Runs::new();
    let (first, whole, killed) =
        (runs.folder("first"), runs.folder("whole"), runs.folder("killed"));
    train(&first, &["run.iterations=2"]);
    let start = format!("policy.start={}:last", text(&first));
    let settings = ["run.seed=8", FOUR, &start];
    train(&whole, &[&settings[..], &["run.actors=1"]].concat());
    let policies = fs::read(first.join("checkpoints/iter_00000002/policy.safetensors")).unwrap();
    let provenance = fs::read_to_string(whole.join("provenance.jsonl")).unwrap();
    let line: serde_json::Value = serde_json::from_str(provenance.lines().next().unwrap()).unwrap();
    assert_eq!(line["behaviour"]["digest"], Digest::of(&policies).to_string());

    // It has no checkpoint yet.
    let mut run = tiny("train", &killed, &settings);
    let ended = run.env("S2MIA_FAIL_AT", "mid-update@1").output().unwrap();
    assert!(!ended.status.success());
    fs::remove_dir_all(&first).unwrap();
    succeeded(&["train", "--resume", text(&killed), "run.actors=3", &start]);
    assert_eq!(inspect(&killed), inspect(&whole));

    let pack = runs.folder("pack");
    succeeded(&["pack", text(&whole), "--out", text(&pack)]);
    for run in [&whole, &pack] {
        let (printed, logged) = success(&mut command(&["verify", text(run), "--iterations", "4"]));
        assert!(!logged.contains("WARN"), "{logged}");
        assert!(printed.contains("equal: iterations 1 to 2 from the seed"), "{printed}");
        assert!(printed.contains("4 of its 4 iterations"), "{printed}");
    }
    let config = format!("--config={}", text(&whole.join("config.toml")));
    let again = runs.folder("again");
    let folder = format!("run.dir={}", text(&again));
    let line = refused(&["train", &config, &folder]);
    assert!(line.contains("config.toml: policy.start: there is no run folder `"), "{line}");
    let kept = format!("policy.start={}", text(&pack.join("start_policies.safetensors")));
    success(&mut command(&["train", &config, &folder, &kept]));
    assert_eq!(inspect(&again), inspect(&whole));
    let line = refused(&["train", "--resume", text(&again), "policy.start=halfcheetah-2x3"]);
    assert!(line.contains("`policy.start` cannot change on resume"), "{line}");
    let (kept, packed) = (whole.join("start_policies.safetensors"), runs.folder("damaged"));
    fs::copy(again.join("checkpoints/iter_00000004/policy.safetensors"), &kept).unwrap();
    for command in [&["verify", text(&whole)][..], &["pack", text(&whole), "--out", text(&packed)]]
    {
        let line = failed(command, 1);
        assert!(line.contains("/whole/start_policies.safetensors has the SHA-256 "), "{line}");
    }
    fs::remove_file(&kept).unwrap();
    let line = failed(&["pack", text(&whole), "--out", text(&packed)], 1);
    assert!(line.contains("/whole/start_policies.safetensors: "), "{line}");
}

#[test]
fn policies_of_another_shape_are_refused_with_both_and_nothing_is_written() {
    let runs = Runs::new();
    let (first, second) = (runs.folder("first"), runs.folder("second"));
    train(&first, &["run.iterations=1"]);
    let start = format!("policy.start={}", text(&first));
    for (settings, shapes) in [
        (["policy.hidden=9", "run.seed=8"], ["encoder 8, hidden 8,", "encoder 8, hidden 9,"]),
        (["task=halfcheetah-2x3", "run.seed=8"], ["those of 6 agents", "the run has 2"]),
        (["observation.norm=none", "run.seed=8"], ["observation.norm = running", "has none"]),
    ] {
        let line = failure(&mut tiny("train", &second, &[&settings[..], &[&start]].concat()), 2);
        for shape in shapes {
            assert!(line.contains("policy.start: ") && line.contains(shape), "{line}");
        }
        assert!(!second.exists());
    }
}

#[test]
fn a_run_that_starts_from_a_trained_team_begins_with_its_return() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let records: toml::Table = include_str!("../../pretrained/teams.toml").parse().unwrap();
    let trained = records[TASK]["return_mean"].as_float().unwrap();
    let (start, folder_setting) =
        (format!("policy.start={TASK}"), format!("run.dir={}", text(&folder)));
    let printed = succeeded(&[
        "train",
        TASK,
        &start,
        &folder_setting,
        "run.seed=3",
        "run.iterations=1",
        "evaluation.episodes=1",
    ]);
    assert!(printed.contains(&format!("env steps, from the policies of {TASK}\n")), "{printed}");
    let first = metrics(&folder, "evaluation")[0]["mean"].as_f64().unwrap();
    assert!(first > 0.5 * trained, "{first} of {trained}");
}
