//! Every file in `configs/` loads and is valid, and a resolved configuration can be read again.

use std::path::{Path, PathBuf};
use std::process::Command;

fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(folder);
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.is_file());
    files.sort();
    assert!(!files.is_empty());
    files
}

fn resolved(arguments: &[&str]) -> String {
    let output =
        Command::new(env!("CARGO_BIN_EXE_s2mia")).arg("config").args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn every_task_and_algorithm_file_is_found_by_its_name() {
    for task in files("tasks") {
        for algorithm in files("algorithms") {
            let (task, algorithm) = (task.file_stem().unwrap(), algorithm.file_stem().unwrap());
            let (task, algorithm) = (task.to_str().unwrap(), algorithm.to_str().unwrap());
            // MADDPG is not defined for a task with discrete actions.
            if (task, algorithm) == ("cue-2x1", "maddpg") {
                continue;
            }
            let text = resolved(&[task, &format!("algorithm={algorithm}")]);
            assert!(text.contains(&format!("# configs/algorithms/{algorithm}.toml")), "{text}");
            let changed = std::fs::read_to_string(format!("configs/tasks/{task}.toml")).unwrap();
            let origin = format!("# configs/tasks/{task}.toml");
            assert_eq!(text.contains(&origin), changed.contains(" = "), "{text}");
        }
    }
}

#[test]
fn every_file_also_loads_as_a_separate_layer() {
    for file in ["", "tasks", "algorithms"].into_iter().flat_map(files) {
        resolved(&["--config", file.to_str().unwrap()]);
    }
}

#[test]
fn maddpg_has_ten_environments_and_fifty_steps_in_slots_for_the_connected_threads() {
    let text = resolved(&["algorithm=maddpg"]);
    let value = |key: &str| {
        let line = text.lines().find(|line| line.starts_with(&format!("{key} = "))).unwrap();
        line.split(['=', '#']).nth(1).unwrap().trim().to_owned()
    };
    assert_eq!([value("count"), value("per_slot"), value("steps")], ["10", "0", "50"]);
    assert_eq!([value("rule"), value("core")], ["\"maddpg\"", "\"mlp\""]);
}

#[test]
fn a_printed_configuration_can_be_read_with_the_same_hash() {
    let folder = tempfile::tempdir().unwrap();
    let first = resolved(&["halfcheetah-6x1", "algorithm=happo", "run.seed=9"]);
    let path = folder.path().join("mine.toml");
    std::fs::write(&path, &first).unwrap();
    let again = resolved(&["--config", path.to_str().unwrap()]);
    let hash = |text: &str| text.lines().last().unwrap().to_owned();
    assert!(hash(&first).starts_with("# config_sha256 = "));
    assert_eq!(hash(&again), hash(&first));
}
