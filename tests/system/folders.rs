//! What commands do with folders and files that exist: runs, checkpoints, files of others, links and pipes.

use std::process::Command;

use crate::commands::{refused, text};
use crate::runs::{Runs, TINY, inspect, s2mia, succeeded, train};

#[test]
fn a_checkpoint_is_read_in_the_place_of_a_run_and_no_run_starts_in_it() {
    let runs = Runs::new();
    let run = runs.folder("my run");
    train(&run, &["run.iterations=2", "run.actors=1", "checkpoint.every=1"]);
    let (whole, first) = (inspect(&run), run.join("checkpoints/iter_00000001"));
    let before = inspect(&first);
    assert_eq!((&whole["iteration"], &before["iteration"]), (&2.into(), &1.into()));
    assert!(succeeded(&["eval", text(&first), "--episodes", "1"]).contains("evaluation-1-0"));
    assert!(succeeded(&["status", text(&first)]).contains("my run is finished"));
    succeeded(&["film", text(&first), "--frames", "1"]);
    succeeded(&["record", text(&first)]);
    assert!(run.join("film.png").is_file() && run.join("logs/iter_00000001.mcap").is_file());
    succeeded(&["export", text(&first), "--onnx", text(&runs.folder("onnx"))]);
    let copy = runs.folder("copy");
    assert!(Command::new("cp").arg("-r").args([&first, &copy]).status().unwrap().success());
    assert_eq!(inspect(&copy), before);
    assert!(refused(&["film", text(&copy)]).contains("with --out"));
    for command in ["train", "learner"] {
        let line = refused(&[command, "--resume", text(&first)]);
        assert!(line.contains("is a checkpoint; `s2mia train --resume '"), "{line}");
        assert!(refused(&[command, "--resume", text(&copy)]).contains("without its run"));
        for inside in [&first, &run.join("logs"), &run.join("tensorboard/new")] {
            let dir = format!("run.dir={}", inside.display());
            let line = refused(&[&[command], TINY, &[&dir]].concat());
            assert!(line.contains("is inside the run") && line.contains("my run,"), "{line}");
        }
    }
    assert_eq!((inspect(&run), inspect(&first)), (whole, before));
}

#[test]
fn a_run_starts_in_a_folder_with_files_of_others_only_on_request() {
    let runs = Runs::new();
    let folder = runs.folder("thesis");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("thesis.tex"), "").unwrap();
    let dir = format!("run.dir={}", folder.display());
    let line = refused(&[&["train"], TINY, &[&dir]].concat());
    assert!(line.contains("is not empty: it contains thesis.tex"), "{line}");
    assert_eq!(folder.read_dir().unwrap().count(), 1);
    train(&folder, &["run.iterations=1", "run.actors=1", "--force"]);
    assert!(folder.join("manifest.json").is_file() && folder.join("thesis.tex").is_file());
}

#[test]
fn existing_files_are_replaced_only_on_request() {
    let runs = Runs::new();
    let run = runs.folder("run");
    train(&run, &["run.iterations=1", "run.actors=1"]);
    let [png, mcap, movie] = ["a.png", "a.mcap", "x.mp4"].map(|name| runs.folder(name));
    let [onnx, figures, pictures, task] =
        ["onnx", "figures", "pictures", "task"].map(|name| runs.folder(name));
    let run = text(&run);
    let commands = [
        vec!["film", run, "--frames", "1", "--out", text(&png)],
        vec!["record", run, "--out", text(&mcap)],
        vec!["export", run, "--onnx", text(&onnx)],
        vec!["plot", run, "--out", text(&figures)],
        vec!["tasks", "--picture", text(&pictures)],
        vec!["task", "new", text(&task)],
    ];
    for command in commands {
        succeeded(&command);
        let line = refused(&command);
        assert!(line.contains("already exists") && line.contains("--force"), "{line}");
        succeeded(&[&command[..], &["--force"]].concat());
    }
    for command in ["film", "record"] {
        let line = refused(&[command, run, "--out", text(&movie)]);
        assert!(line.contains("x.mp4: the file has the format of ."), "{line}");
        assert!(!movie.exists());
    }
    std::fs::write(onnx.join("agent_7.onnx"), "").unwrap();
    succeeded(&["export", run, "--onnx", text(&onnx), "--force"]);
    assert!(onnx.join("agent_5.onnx").is_file() && !onnx.join("agent_7.onnx").exists());
}

#[test]
fn pipes_and_links_in_a_run_folder_are_refused_in_one_line() {
    let runs = Runs::new();
    let run = runs.folder("run");
    train(&run, &["run.iterations=1", "run.actors=1"]);
    for (name, commands) in [
        ("metrics.jsonl", &[&["plot"][..], &["train", "--resume"]][..]),
        ("config.toml", &[&["plot"], &["train", "--resume"]]),
        ("learner.lock", &[&["status"], &["train", "--resume"]]),
        ("film.png", &[&["film"]]),
    ] {
        let (path, kept) = (run.join(name), run.join("kept"));
        let there = std::fs::rename(&path, &kept).is_ok();
        for make in [&["mkfifo"][..], &["ln", "-s", "kept"]] {
            let made = Command::new(make[0]).args(&make[1..]).arg(&path).status().unwrap();
            assert!(made.success());
            for command in commands {
                let output = s2mia(&[command, &[text(&run)][..]].concat());
                let line = String::from_utf8(output.stderr).unwrap();
                assert!(!output.status.success() && line.contains(name), "{command:?}: {line}");
                assert!(line.contains("not a plain file"), "{command:?}: {line}");
            }
            std::fs::remove_file(&path).unwrap();
        }
        assert!(!there || std::fs::rename(&kept, &path).is_ok());
    }
    succeeded(&["train", "--resume", text(&run)]);
}

#[test]
fn a_tilde_is_the_home_folder_in_arguments_settings_and_files() {
    let runs = Runs::new();
    let home = runs.folder("home");
    std::fs::create_dir(&home).unwrap();
    let at_home = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
        let output = command.args(arguments).env("HOME", &home).output().unwrap();
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let short = ["run.iterations=1", "run.actors=1", "run.dir=~/x"];
    assert_eq!(at_home(&[&["train"], TINY, &short].concat()), (true, String::new()));
    assert!(home.join("x/manifest.json").is_file());
    assert_eq!(at_home(&["film", "~/x", "--out=~/a.png"]), (true, String::new()));
    assert!(home.join("a.png").is_file());
    assert_eq!(at_home(&["status", "~/x"]), (true, String::new()));
    assert_eq!(at_home(&["task", "new", "~/robot"]), (true, String::new()));
    assert_eq!(at_home(&["task", "check", "~/robot/hopper.toml"]), (true, String::new()));
    assert_eq!(at_home(&["config", "~/robot/hopper.toml"]), (true, String::new()));
    for arguments in [&["inspect", "~nobody/x"][..], &["train", "run.dir=~nobody/x"]] {
        let (succeeded, line) = at_home(arguments);
        assert!(!succeeded && line.contains("~nobody/x: write the whole path"), "{line}");
    }
}
