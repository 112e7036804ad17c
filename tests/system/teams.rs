//! The trained teams that come with the program, in any folder.

use std::path::Path;
use std::process::Command;

use crate::processes::Background;
use crate::runs::{Runs, command, failure, success};

/// A task with a team.
pub(crate) const TASK: &str = "halfcheetah-pushed-2x3";

/// `s2mia` in a folder.
pub(crate) fn within(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = command(arguments);
    command.current_dir(folder);
    command
}

#[test]
fn a_team_is_filmed_evaluated_recorded_exported_and_served_by_the_name_of_its_task() {
    let runs = Runs::new();
    let folder = runs.folder("anywhere");
    std::fs::create_dir(&folder).unwrap();
    let printed_by = |arguments: &[&str]| success(&mut within(&folder, arguments)).0;
    let records: toml::Table = include_str!("../../pretrained/teams.toml").parse().unwrap();
    let first = records[TASK]["first_return"].as_float().unwrap();
    let shown = format!("return {first:.2}, 1000 steps");
    let name = "episode 0 (evaluation-1000-0, seed 1)";
    for arguments in [
        &["film", TASK][..],
        &["film", TASK, "--still"],
        &["record", TASK],
        &["export", TASK, "--onnx", "onnx"],
    ] {
        let printed = printed_by(arguments);
        assert!(printed.contains(name) && printed.contains(&shown), "{arguments:?}: {printed}");
    }
    let gif = std::fs::read(folder.join(format!("{TASK}.gif"))).unwrap();
    assert!(gif.starts_with(b"GIF89a") && gif.len() < 1_000_000, "{} bytes", gif.len());
    for file in [&format!("{TASK}.png"), &format!("{TASK}.mcap"), "onnx/agent_1.onnx"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
    for command in ["film", "record"] {
        let line = failure(&mut within(&folder, &[command, TASK]), 2);
        assert!(line.contains("already exists") && line.contains("--force"), "{line}");
    }
    let measured = printed_by(&["eval", TASK, "--episodes", "1", "--json"]);
    let measured: serde_json::Value = serde_json::from_str(&measured).unwrap();
    assert_eq!(measured["return_mean"], first);
    assert_eq!((&measured["seed"], &measured["env_steps"]), (&1.into(), &1_000_000.into()));
    let mut server =
        Background::start(&mut within(&folder, &["serve", TASK, "--listen=127.0.0.1:0"]));
    let line = server.line();
    assert!(line.starts_with(&format!("{TASK} serves its policies of iteration 1000 on http")));
    server.stop();
}

#[test]
fn a_name_without_a_team_is_answered_with_the_nearest_or_with_how_to_train_one() {
    let runs = Runs::new();
    let folder = runs.folder("here");
    std::fs::create_dir_all(folder.join(TASK)).unwrap();
    for command in ["film", "eval", "record", "serve"] {
        for (name, part) in [
            ("halfcheetah-pushed-2x2", "did you mean `halfcheetah-pushed-2x3`?"),
            ("cue-2x1", "train one with `s2mia train cue-2x1`"),
            ("no/such/run", "there is no run folder `no/such/run`"),
            ("nonsense", "is neither a folder nor a task with a trained team; tasks with"),
            // A folder comes before a team.
            (TASK, "is no run folder: it has no config.toml"),
        ] {
            let line = failure(&mut within(&folder, &[command, name]), 2);
            assert!(line.contains(part), "{command} {name}: {line}");
        }
    }
}
