//! Packs are verified and used on another machine without their run, and hold nothing of the first machine.

use std::fs;
use std::path::{Path, PathBuf};

use crate::runs::{Runs, evaluated, failed, inspect, refused, succeeded, text, train};
use crate::verify::{SIX, doubted, whole};

/// The names and contents of all files in a folder, in the order of their paths.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for path in next.read_dir().unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_path_buf();
                found.push((name, fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

#[test]
fn a_pack_is_verified_and_used_without_its_run_and_has_no_secret_and_no_path_of_the_machine() {
    let runs = Runs::new();
    let (run, pack, again) = (runs.folder("run"), runs.folder("pack"), runs.folder("again"));
    train(&run, &[SIX]);
    fs::write(run.join("checkpoints/iter_00000002/notes.txt"), "mine").unwrap();
    let whole_run = inspect(&run);
    let played = evaluated(text(&run), &["--episodes", "1"]);
    let printed = succeeded(&["pack", text(&run), "--out", text(&pack)]);
    assert!(printed.contains("6 iterations, 3 checkpoints"), "{printed}");
    succeeded(&["pack", text(&run), "--out", text(&again)]);
    assert_eq!(contents(&pack), contents(&again), "the same run makes the same bytes");
    for (name, _) in contents(&pack) {
        let top = name.components().next().unwrap().as_os_str().to_str().unwrap().to_owned();
        let known = ["checkpoints", "config.toml", "manifest.json", "metrics.jsonl"];
        let more = ["provenance.jsonl", "starts.jsonl"];
        assert!(known.contains(&&*top) || more.contains(&&*top), "{name:?}");
        assert!(!name.ends_with("notes.txt"), "{name:?}");
    }
    let token = fs::read_to_string(run.join("token")).unwrap();
    let host = fs::read_to_string("/etc/hostname").unwrap_or_default();
    let home = std::env::var("HOME").unwrap_or_default();
    let parent = run.parent().unwrap().to_path_buf();
    let secrets = [token.trim(), text(&parent), home.trim(), host.trim()];
    // A shorter name may be part of any word.
    for secret in secrets.into_iter().filter(|secret| secret.len() > 5) {
        for (name, bytes) in contents(&pack) {
            let found = bytes.windows(secret.len()).any(|part| part == secret.as_bytes());
            assert!(!found, "{secret} is in {name:?}");
        }
    }
    let line = refused(&["pack", text(&run), "--out", text(&pack)]);
    assert!(line.contains("already exists; name another place"), "{line}");
    assert!(refused(&["pack", text(&run), "--out", text(&run.join("in"))]).contains("inside the"));

    fs::remove_dir_all(&run).unwrap();
    let printed = succeeded(&whole(&pack));
    assert!(printed.contains("6 of its 6 iterations and 4 of its 4 evaluations"), "{printed}");
    assert_eq!(inspect(&pack), whole_run);
    assert_eq!(evaluated(text(&pack), &["--episodes", "1"]), played);
    succeeded(&["film", text(&pack), "--frames", "1"]);
    succeeded(&["export", text(&pack), "--onnx", text(&runs.folder("onnx"))]);
    let packed_again = runs.folder("packed");
    succeeded(&["pack", text(&pack), "--out", text(&packed_again)]);
    assert_eq!(contents(&packed_again), contents(&again));
}

#[test]
fn damaged_records_and_a_checkpoint_in_the_place_of_a_run_are_not_packed() {
    let runs = Runs::new();
    let (run, pack) = (runs.folder("run"), runs.folder("pack"));
    train(&run, &["run.iterations=2"]);
    let first = run.join("checkpoints/iter_00000002");
    for command in ["verify", "pack"] {
        let line = refused(&[command, text(&first)]);
        assert!(line.contains("is a checkpoint") && line.contains("name its run"), "{line}");
    }
    fs::remove_file(first.join("policy.safetensors")).unwrap();
    let line = failed(&["pack", text(&run), "--out", text(&pack)], 1);
    assert!(line.contains("cannot be packed: ") && line.contains("policy.safetensors"), "{line}");
    fs::remove_dir_all(run.join("checkpoints/iter_00000002")).unwrap();
    let line = failed(&["pack", text(&run), "--out", text(&pack)], 1);
    assert!(line.contains("it has no checkpoint"), "{line}");
    assert!(!pack.exists());
    let printed = succeeded(&["verify", text(&run)]);
    assert!(printed.contains("equal: iterations 1 to 2 from the seed"), "{printed}");
    fs::remove_file(run.join("provenance.jsonl")).unwrap();
    assert!(doubted(&run, 1).contains("provenance.jsonl is missing or has no line"));
}
