//! A task that is not part of the program: its files are checked and trained, and the run needs them no more.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/runs.rs"]
mod runs;

use std::path::Path;

use runs::{Runs, inspect, s2mia, succeeded, train};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Writes the example into a new folder and returns the path of its task file.
fn example(runs: &Runs) -> std::path::PathBuf {
    let folder = runs.folder("robot");
    succeeded(&["task", "new", text(&folder)]);
    folder.join("hopper.toml")
}

/// The error of a command that is refused in one line.
fn refusal(arguments: &[&str]) -> String {
    let output = s2mia(arguments);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert_eq!(error.lines().count(), 1, "{error}");
    error
}

#[test]
fn the_commands_of_the_document_check_and_train_the_example() {
    let runs = Runs::new();
    let document = include_str!("../docs/ADDING_A_TASK.md");
    let commands = document.split("```").nth(1).unwrap();
    let mut count = 0;
    for command in commands.lines().filter_map(|line| line.strip_prefix("s2mia ")) {
        let folder = runs.folder("my-robot");
        let command = command.replace("my-robot", text(&folder));
        let mut arguments: Vec<&str> = command.split_whitespace().collect();
        let dir = format!("run.dir={}", runs.folder("run").display());
        if arguments[0] == "train" {
            arguments.extend(["run.iterations=2", "run.actors=1", &dir]);
        }
        succeeded(&arguments);
        count += 1;
    }
    assert_eq!(count, 3);
    assert!(runs.folder("my-robot").join("hopper.png").is_file());
    assert_eq!(inspect(&runs.folder("run"))["iteration"], 2);
}

#[test]
fn a_run_of_an_own_task_continues_and_is_evaluated_without_its_files() {
    let runs = Runs::new();
    let task = example(&runs);
    let (whole, resumed) = (runs.folder("whole"), runs.folder("resumed"));
    let named = format!("task={}", text(&task));
    train(&whole, &[&named, "run.iterations=4", "run.actors=1"]);
    train(&resumed, &[&named, "run.iterations=2", "run.actors=2"]);
    std::fs::remove_dir_all(task.parent().unwrap()).unwrap();
    let run = text(&resumed);
    succeeded(&["train", "--resume", run, "run.iterations=4"]);
    assert_eq!(inspect(&whole), inspect(&resumed));
    succeeded(&["eval", run, "--episodes", "1"]);
    succeeded(&["film", run, "--frames", "1"]);
    succeeded(&["record", run]);
    succeeded(&["export", run, "--onnx", text(&runs.folder("onnx"))]);
}

#[test]
fn a_resume_with_another_file_is_refused_in_one_line() {
    let runs = Runs::new();
    let task = example(&runs);
    let folder = runs.folder("run");
    train(&folder, &[&format!("task={}", text(&task)), "run.iterations=1", "run.actors=1"]);
    let changed = std::fs::read_to_string(&task).unwrap().replace("weight = 1e-3", "weight = 1e-2");
    std::fs::write(&task, changed).unwrap();
    let error = refusal(&["train", "--resume", text(&folder), &format!("task={}", text(&task))]);
    assert!(error.contains("`task_file.text` cannot change on resume"), "{error}");
}

#[test]
fn an_invalid_file_is_refused_with_its_path_before_anything_is_written() {
    let runs = Runs::new();
    let task = example(&runs);
    let valid = std::fs::read_to_string(&task).unwrap();
    let folder = runs.folder("run");
    let dir = format!("run.dir={}", folder.display());
    for (from, to, part) in [
        ("hopper.xml", "lost.xml", "lost.xml"),
        ("frame_skip", "fram_skip", "did you mean `frame_skip`?"),
        ("\"alive\"", "\"alife\"", "did you mean `alive`?"),
        ("[\"knee\"]]", "[\"kne\"]]", "did you mean `knee`?"),
        ("robot = \"hopper\"", "robot = \"cue\"", "the task `cue-2x1` is part of the program"),
        ("[start]", "[settings.update]\nlerning_rate = 1\n[start]", "`update.learning_rate`?"),
        ("[start]", "[settings]\nalgorithm = \"happo\"\n[start]", "settings.algorithm"),
        (
            "2x1 = [[\"hip\"], [\"knee\"]]",
            "a = [[\"hip\", \"knee\"]]\nb = [[\"hip\"], [\"knee\"]]",
            "hopper.toml:b",
        ),
    ] {
        assert!(valid.contains(from), "{from}");
        std::fs::write(&task, valid.replacen(from, to, 1)).unwrap();
        let error = refusal(&["train", text(&task), &dir]);
        assert!(error.contains(part) && error.contains(text(&task)), "{error}");
        assert!(!folder.exists());
    }
    let twice = refusal(&["task", "new", text(task.parent().unwrap())]);
    assert!(twice.contains("exists already"), "{twice}");
}

#[test]
fn a_partition_is_named_exactly() {
    let runs = Runs::new();
    let task = example(&runs);
    let agents = "2x1 = [[\"hip\"], [\"knee\"]]";
    let one = "a-b = [[\"hip\", \"knee\"]]";
    let valid = std::fs::read_to_string(&task).unwrap();
    let with = |partitions: &str| std::fs::write(&task, valid.replacen(agents, partitions, 1));
    let b = format!("{}:b", text(&task));
    with(&format!("{one}\nb = [[\"hip\"], [\"knee\"]]")).unwrap();
    let told = succeeded(&["task", "check", &b, "--episodes", "1"]);
    assert!(told.starts_with("hopper-b: 2 agents"), "{told}");
    with(one).unwrap();
    let error = refusal(&["task", "check", &b, "--episodes", "1"]);
    assert!(error.contains("hopper.toml:a-b"), "{error}");
}
