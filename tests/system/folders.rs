//! What commands do with folders and files that exist: runs, checkpoints, files of others, links and pipes.

use std::process::Command;

use crate::runs::{
    Runs, command, error, failure, inspect, refused, s2mia, succeeded, success, text, tiny, train,
};

const ONE: [&str; 2] = ["run.iterations=1", "run.actors=1"];

#[test]
fn a_checkpoint_is_read_in_the_place_of_a_run_and_no_run_starts_in_it() {
    let runs = Runs::new();
    let run = runs.folder("my run");
    train(&run, &["run.iterations=2", "run.actors=1", "checkpoint.every=1"]);
    let whole = inspect(&run);
    let first = run.join("checkpoints/iter_00000001");
    let before = inspect(&first);
    assert_eq!((&whole["iteration"], &before["iteration"]), (&2.into(), &1.into()));
    assert!(succeeded(&["eval", text(&first), "--episodes", "1"]).contains("evaluation-1-0"));
    assert!(succeeded(&["status", text(&first)]).contains("my run is finished"));
    for named in [&[][..], &[text(&run)]] {
        let printed =
            succeeded(&[&["inspect", "--json", "--checkpoint", text(&first)], named].concat());
        assert_eq!(serde_json::from_str::<serde_json::Value>(&printed).unwrap(), before);
    }
    succeeded(&["film", text(&first), "--frames", "1"]);
    succeeded(&["record", text(&first)]);
    assert!(run.join("film.gif").is_file() && run.join("logs/iter_00000001.mcap").is_file());
    succeeded(&["export", text(&first), "--onnx", text(&runs.folder("onnx"))]);
    let copy = runs.folder("copy");
    assert!(Command::new("cp").arg("-r").args([&first, &copy]).status().unwrap().success());
    assert_eq!(inspect(&copy), before);
    assert!(refused(&["film", text(&copy)]).contains("with --out"));
    for role in ["train", "learner"] {
        let line = refused(&[role, "--resume", text(&first)]);
        assert!(line.contains("is a checkpoint; `s2mia train --resume '"), "{line}");
        assert!(refused(&[role, "--resume", text(&copy)]).contains("without its run"));
        for inside in [&first, &run.join("logs"), &run.join("tensorboard/new")] {
            let line = failure(&mut tiny(role, inside, &[]), 2);
            assert!(line.contains("is inside the run") && line.contains("my run,"), "{line}");
        }
    }
    assert!(failure(&mut tiny("train", &run, &[]), 2).contains("--resume"));
    assert_eq!((inspect(&run), inspect(&first)), (whole, before));
}

#[test]
fn a_run_starts_in_a_folder_with_files_of_others_only_on_request() {
    let runs = Runs::new();
    let folder = runs.folder("thesis");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("thesis.tex"), "").unwrap();
    let line = failure(&mut tiny("train", &folder, &[]), 2);
    assert!(line.contains("is not empty: it contains thesis.tex"), "{line}");
    assert_eq!(folder.read_dir().unwrap().count(), 1);
    train(&folder, &[&ONE[..], &["--force"]].concat());
    assert!(folder.join("manifest.json").is_file() && folder.join("thesis.tex").is_file());
}

#[test]
fn a_run_that_was_moved_is_resumed_where_run_dir_names_its_folder_in_any_way() {
    let runs = Runs::new();
    let [first, moved, link] = ["first", "moved", "link"].map(|name| runs.folder(name));
    train(&first, &ONE);
    std::fs::rename(&first, &moved).unwrap();
    std::os::unix::fs::symlink(&moved, &link).unwrap();
    for (iterations, resumed, named) in
        [(2, &moved, &moved), (3, &link, &moved), (4, &moved, &link)]
    {
        let length = format!("run.iterations={iterations}");
        let named = format!("run.dir={}", text(named));
        succeeded(&["train", "--resume", text(resumed), &named, &length]);
        assert_eq!(inspect(&moved)["iteration"], iterations);
    }
    let other = format!("run.dir={}", text(&first));
    let line = refused(&["train", "--resume", text(&moved), &other]);
    assert!(
        line.contains("a resumed run stays in its folder") && line.contains("/moved;"),
        "{line}"
    );
}

#[test]
fn a_page_whose_port_is_in_use_is_a_failure_and_no_wrong_setting() {
    let runs = Runs::new();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = tiny("train", &runs.folder("run"), &["--page", &address]).output().unwrap();
    let line = error(&output);
    assert_eq!(output.status.code(), Some(1), "{line}");
    assert!(line.contains("in use") && line.contains("choose another port"), "{line}");
}

/// Repeats a command that writes files: without `--force` it is refused.
fn demand_force(command: &[&str]) {
    succeeded(command);
    let line = refused(command);
    assert!(line.contains("already exists") && line.contains("--force"), "{line}");
    succeeded(&[command, &["--force"]].concat());
}

#[test]
fn existing_files_are_replaced_only_on_request_and_no_folder_around_a_file_is_created() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    train(&folder, &ONE);
    let (run, onnx) = (text(&folder), runs.folder("onnx"));
    let missing = runs.folder("mising");
    for (words, option, name) in [
        (&["film", run, "--frames", "1"][..], "--out", "a.gif"),
        (&["record", run], "--out", "a.mcap"),
        (&["export", run], "--onnx", "onnx"),
        (&["plot", run], "--out", "figures"),
        (&["task", "new"], "", "task"),
    ] {
        let at = |path| {
            let target = if option.is_empty() { vec![path] } else { vec![option, path] };
            [words, &target[..]].concat()
        };
        let path = runs.folder(name);
        demand_force(&at(text(&path)));
        if !option.is_empty() {
            let inside = missing.join(name);
            let why = format!(
                "{option} {}: there is no folder {}; create",
                text(&inside),
                text(&missing)
            );
            let line = refused(&at(text(&inside)));
            assert!(line.contains(&why), "{line}");
            assert!(!missing.exists(), "{words:?}");
        }
    }
    for own in [&["film", run, "--frames", "1"][..], &["record", run], &["plot", run]] {
        demand_force(own);
    }
    assert!(refused(&["record", run, "--out", run]).contains("is a folder; name a file"));
    let figures = runs.folder("figures");
    assert!(figures.join("learning_curve.png").is_file());
    std::fs::write(onnx.join("agent_7.onnx"), "").unwrap();
    succeeded(&["export", run, "--onnx", text(&onnx), "--force"]);
    assert!(onnx.join("agent_5.onnx").is_file() && !onnx.join("agent_7.onnx").exists());
}

#[test]
fn pipes_and_links_in_a_run_folder_are_refused_in_one_line() {
    let runs = Runs::new();
    let run = runs.folder("run");
    train(&run, &ONE);
    for (name, commands) in [
        ("metrics.jsonl", &[&["plot"][..], &["train", "--resume"]][..]),
        ("config.toml", &[&["train", "--resume"]]),
        ("learner.lock", &[&["status"], &["train", "--resume"]]),
    ] {
        let (path, kept) = (run.join(name), run.join("kept"));
        let there = std::fs::rename(&path, &kept).is_ok();
        for make in [&["mkfifo"][..], &["ln", "-s", "kept"]] {
            let made = Command::new(make[0]).args(&make[1..]).arg(&path).status().unwrap();
            assert!(made.success());
            for command in commands {
                let output = s2mia(&[command, &[text(&run)][..]].concat());
                let line = error(&output);
                assert!(!output.status.success() && line.contains(name), "{command:?}: {line}");
                assert!(line.contains("not a plain file"), "{command:?}: {line}");
            }
            std::fs::remove_file(&path).unwrap();
        }
        assert!(!there || std::fs::rename(&kept, &path).is_ok());
    }
    succeeded(&["train", "--resume", text(&run)]);
    assert!(Command::new("mkfifo").arg(run.join("film.gif")).status().unwrap().success());
    for more in [&[][..], &["--force"]] {
        let line = refused(&[&["film", text(&run)], more].concat());
        assert!(line.contains("film.gif: ") && line.contains("not a plain file"), "{line}");
    }
}

#[test]
fn a_tilde_is_the_home_folder_in_arguments_settings_and_files() {
    let runs = Runs::new();
    let home = runs.folder("home");
    std::fs::create_dir(&home).unwrap();
    let mut run = tiny("train", "~/x".as_ref(), &ONE);
    assert_eq!(success(run.env("HOME", &home)).1, "");
    for arguments in [
        &["film", "~/x", "--out=~/a.gif"][..],
        &["status", "~/x"],
        &["task", "new", "~/robot"],
        &["task", "check", "~/robot/hopper.toml"],
        &["config", "~/robot/hopper.toml"],
    ] {
        assert_eq!(success(command(arguments).env("HOME", &home)).1, "", "{arguments:?}");
    }
    assert!(home.join("x/manifest.json").is_file() && home.join("a.gif").is_file());
    for arguments in [&["inspect", "~nobody/x"][..], &["train", "run.dir=~nobody/x"]] {
        let line = failure(command(arguments).env("HOME", &home), 2);
        assert!(line.contains("~nobody/x: write the whole path"), "{line}");
    }
}
