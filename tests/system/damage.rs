//! Damaged files in a run folder: every reader notices, no run is lost, and a resume repairs what it can.

use std::path::Path;

use crate::runs::{
    Runs, error, inspect, json, metrics, refused, succeeded, text, tiny, train, warned,
};

fn resume(folder: &Path) -> String {
    warned(&["train", "--resume", text(folder), "run.iterations=4"])
}

#[test]
fn a_damaged_config_is_replaced_by_the_checkpoints_copy_and_a_resume_restores_it() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=2"]);
    let config = folder.join("config.toml");
    let good = std::fs::read_to_string(&config).unwrap();
    let eval = ["eval", text(&folder), "--episodes", "1", "--json"];
    let played = succeeded(&eval);
    let changed = good.replace("task = \"halfcheetah-6x1\"", "task = \"halfcheetah-3x2\"");
    assert_ne!(changed, good);
    for (damaged, why) in [
        (String::new(), "these are not the run's settings"),
        (good[..good.len() / 2].to_owned(), "config.toml"),
        (changed, "these are not the run's settings"),
    ] {
        std::fs::write(&config, &damaged).unwrap();
        let printed = warned(&eval);
        assert!(printed.contains(why), "{printed}");
        assert!(printed.contains("iter_00000002/config.toml are used"), "{printed}");
        assert_eq!(succeeded(&eval), played);
    }
    resume(&folder);
    let kept = std::fs::read_to_string(folder.join("config.toml.damaged")).unwrap();
    assert!(kept.contains("task = \"halfcheetah-3x2\""), "{kept}");
    std::fs::remove_file(&config).unwrap();
    resume(&folder);
    let restored = std::fs::read_to_string(&config).unwrap();
    assert_eq!(restored.replace("iterations = 4", "iterations = 2"), good);
    assert_eq!(inspect(&folder)["iteration"], 4);
    std::fs::remove_file(&config).unwrap();
    std::fs::remove_dir_all(folder.join("checkpoints")).unwrap();
    let line = refused(&["train", "--resume", text(&folder)]);
    assert!(line.contains("no checkpoint has a copy: restore the file"), "{line}");
}

#[test]
fn a_damaged_manifest_is_reported_and_written_again() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=2"]);
    let manifest = folder.join("manifest.json");
    let good = std::fs::read_to_string(&manifest).unwrap();
    let hash = good.split("\"config_sha256\": \"").nth(1).unwrap();
    let other = if hash.starts_with('0') { '1' } else { '0' };
    let changed = good.replacen(&hash[..64], &format!("{other}{}", &hash[1..64]), 1);
    for (damaged, iterations) in [
        (Some(good.replacen("\"seed\": 7", "\"seed\": 8", 1)), 3),
        (Some(changed), 4),
        (Some(good[..good.len() / 2].to_owned()), 5),
        (None, 6),
    ] {
        match damaged {
            Some(damaged) => {
                assert_ne!(damaged, good);
                std::fs::write(&manifest, damaged).unwrap();
            }
            None => std::fs::remove_file(&manifest).unwrap(),
        }
        let length = format!("run.iterations={iterations}");
        let printed = warned(&["train", "--resume", text(&folder), &length]);
        assert!(printed.contains("the manifest is written again"), "{printed}");
        let written = json(&manifest);
        assert_eq!((&written["seed"], &written["foreign_actors"]), (&7.into(), &().into()));
    }
    let kept = std::fs::read_to_string(folder.join("manifest.json.damaged")).unwrap();
    assert!(kept.contains("\"seed\": 8") && kept.contains(&good[..good.len() / 2]), "{kept}");
    let starts = std::fs::read_to_string(folder.join("starts.jsonl")).unwrap();
    assert_eq!(starts.lines().count(), 5);
}

#[test]
fn a_resume_of_a_whole_run_warns_of_nothing_and_names_what_another_has_lost() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &["run.iterations=3"]);
    assert_eq!(resume(&folder), "");
    let provenance = folder.join("provenance.jsonl");
    let lines = std::fs::read_to_string(&provenance).unwrap();
    let without_second = lines.lines().enumerate().filter(|(index, _)| *index != 1);
    let left: Vec<&str> = without_second.map(|(_, line)| line).collect();
    std::fs::write(&provenance, format!("{}\n", left.join("\n"))).unwrap();
    let printed = resume(&folder);
    assert!(printed.contains("provenance.jsonl has no lines of iterations 2"), "{printed}");
    std::fs::write(&provenance, format!("{lines}half a line\n")).unwrap();
    let printed = resume(&folder);
    assert!(
        printed.contains("provenance.jsonl has 1 damaged line, which is moved to"),
        "{printed}"
    );
    let kept = std::fs::read_to_string(folder.join("provenance.jsonl.damaged")).unwrap();
    assert_eq!(kept, "half a line\n");
    std::fs::remove_dir_all(folder.join("checkpoints/iter_00000004")).unwrap();
    let printed = resume(&folder);
    assert!(printed.contains("the checkpoint of iteration 4 is lost"), "{printed}");
    assert_eq!(resume(&folder), "");
}

#[test]
fn a_start_that_ended_before_its_manifest_is_no_run_and_a_new_run_takes_the_folder() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("learner.lock"), "7\n").unwrap();
    std::fs::write(folder.join("config.toml"), "task = \"ant-2x4\"\n").unwrap();
    train(&folder, &["run.iterations=1"]);
    assert_eq!(inspect(&folder)["iteration"], 1);
}

#[test]
fn a_full_disk_at_a_step_of_a_checkpoint_does_not_affect_training_and_it_is_retried() {
    let runs = Runs::new();
    let quiet = runs.folder("quiet");
    let length = ["run.iterations=4", "evaluation.every_steps=0"];
    train(&quiet, &length);
    for step in ["WriteFile", "Rename", "RemoveOld"] {
        let folder = runs.folder(step);
        let mut run = tiny("train", &folder, &length);
        let ended = run.env("S2MIA_FAIL_AT", format!("{step}@2")).output().unwrap();
        let printed = error(&ended);
        assert!(
            ended.status.success() && printed.contains("checkpoint failed"),
            "{step}: {printed}"
        );
        assert_eq!(inspect(&folder)["state_sha256"], inspect(&quiet)["state_sha256"], "{step}");
        let iterations = metrics(&folder, "iteration");
        let failed = iterations.iter().map(|line| line["checkpoints_failed"].as_f64().unwrap());
        assert_eq!(failed.collect::<Vec<_>>(), [0.0, 0.0, 1.0, 0.0], "{step}");
        assert!(folder.join("checkpoints/iter_00000003").is_dir(), "{step}");
    }
}
