//! Runs are verified by computing them again, and what does not belong to them is found.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use learner::store::checkpoint;
use serde_json::Value;

use crate::cue_service::{CueService, Faults};
use crate::processes::{Background, children, signal};
use crate::roles::another_build;
use crate::runs::{
    Runs, SHORT, SMALL_HASAC, SMALL_MADDPG, command, failed, inspect, metrics, succeeded, success,
    text, tiny, train,
};

/// A run of six iterations of 80 steps: with checkpoints after 2, 4 and 6, and evaluations there and at the start.
pub(crate) const SIX: &str = "run.iterations=6";

/// `s2mia verify` of all iterations of a run.
pub(crate) fn whole(folder: &Path) -> [&str; 4] {
    ["verify", text(folder), "--iterations", "6"]
}

/// The line with which a run is not verified by computing `iterations`.
pub(crate) fn doubted(folder: &Path, iterations: u64) -> String {
    let line = failed_late(&mut command(&[
        "verify",
        text(folder),
        "--iterations",
        &iterations.to_string(),
    ]));
    assert!(line.contains(&format!("{} is not verified: ", text(folder))), "{line}");
    line
}

/// The one line on stderr of a command that ends with status 1, perhaps after some output.
fn failed_late(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{line}");
    assert_eq!(line.lines().count(), 1, "{line}");
    line
}

/// Changes the line of a file that `chosen` chooses.
fn change(file: &Path, chosen: fn(&Value) -> bool, change: impl Fn(&mut Value)) {
    let text = fs::read_to_string(file).unwrap();
    let changed = text.lines().map(|line| {
        let mut line: Value = serde_json::from_str(line).unwrap();
        if chosen(&line) {
            change(&mut line);
        }
        format!("{line}\n")
    });
    let changed: String = changed.collect();
    assert_ne!(changed, text);
    fs::write(file, changed).unwrap();
}

/// A copy of a run.
fn copy(run: &Path, to: PathBuf) -> PathBuf {
    assert!(Command::new("cp").arg("-r").args([run, &to]).status().unwrap().success());
    to
}

#[test]
fn a_run_is_verified_from_its_seed_and_its_checkpoints_also_after_a_crash_and_for_every_rule() {
    for (name, settings) in [
        ("default", &[][..]),
        // Every step depends on the length of the run.
        ("decay", &["update.learning_rate_decay=linear"]),
        ("maddpg", &SMALL_MADDPG),
        ("hasac", &SMALL_HASAC),
    ] {
        let runs = Runs::new();
        let folder = runs.folder(name);
        let mut run = tiny("train", &folder, &[settings, &[SIX]].concat());
        let ended = run.env("S2MIA_FAIL_AT", "mid-update@3").output().unwrap();
        assert!(!ended.status.success());
        succeeded(&["train", "--resume", text(&folder)]);
        let (printed, log) = success(&mut command(&whole(&folder)));
        assert_eq!(log, "", "{printed}");
        for part in [
            "equal: iterations 1 to 2 from the seed, weights_sha256 ",
            "equal: iterations 3 to 4 from the checkpoint of iteration 2, weights_sha256 ",
            "equal: iterations 5 to 6 from the checkpoint of iteration 4, weights_sha256 ",
            "equal: policies of the checkpoint of iteration 6\n",
            "equal: evaluation after iteration 6, return ",
            "is verified: 6 of its 6 iterations and 4 of its 4 evaluations have the recorded results",
        ] {
            assert!(printed.contains(part), "{part} is not in:\n{printed}");
        }
        assert!(
            printed.contains(inspect(&folder)["weights_sha256"].as_str().unwrap()),
            "{printed}"
        );
    }
}

#[test]
fn records_that_end_before_the_run_of_their_settings_are_said_to_be_cut_off() {
    let runs = Runs::new();
    let run = runs.folder("run");
    train(&run, &[SIX]);
    for file in ["metrics.jsonl", "provenance.jsonl"] {
        let path = run.join(file);
        let kept = fs::read_to_string(&path).unwrap();
        let kept = kept.lines().filter(|line| {
            let line: Value = serde_json::from_str(line).unwrap();
            line["iteration"].as_u64().unwrap() <= 2
        });
        let kept: String = kept.map(|line| format!("{line}\n")).collect();
        fs::write(&path, kept).unwrap();
    }
    for later in ["iter_00000004", "iter_00000006"] {
        fs::remove_dir_all(run.join("checkpoints").join(later)).unwrap();
    }
    fs::write(run.join("checkpoints/LATEST"), "iter_00000002\n").unwrap();
    let pack = runs.folder("pack");
    let cut = "; its settings have 6 iterations, so it was stopped, or its records were cut off";
    let packed = succeeded(&["pack", text(&run), "--out", text(&pack)]);
    assert!(packed.contains(&format!("2 iterations, 1 checkpoint{cut}")), "{packed}");
    let (printed, _) = success(&mut command(&whole(&pack)));
    assert!(printed.contains("2 of its 2 iterations") && printed.contains(cut), "{printed}");
}

#[test]
fn a_changed_weight_setting_figure_or_checkpoint_is_found_in_one_line() {
    let runs = Runs::new();
    let run = runs.folder("run");
    train(&run, &[SIX]);
    let changed = |name: &str, file: &str| {
        let folder = copy(&run, runs.folder(name));
        let path = folder.join(file);
        (folder, path)
    };

    let (folder, lines) = changed("weights", "provenance.jsonl");
    let other = Value::from("0".repeat(64));
    let third = |line: &Value| line["iteration"] == 3;
    change(&lines, third, |line| line["weights_sha256"] = other.clone());
    let line = doubted(&folder, 6);
    assert!(line.contains("iteration 3 has weights_sha256 \""), "{line}");
    assert!(line.contains("provenance.jsonl has \"0000") && line.contains("both"), "{line}");
    change(&lines, |line| line["iteration"] == 4, |line| line["weights_sha256"] = other.clone());
    let line = doubted(&folder, 1);
    assert!(line.contains("the weights in ") && line.contains("iter_00000004 have"), "{line}");

    let (folder, lines) = changed("figures", "metrics.jsonl");
    change(&lines, third, |line| line["env_steps"] = 1.into());
    let line = doubted(&folder, 6);
    assert!(line.contains("iteration 3 has env_steps 240, metrics.jsonl has 1;"), "{line}");
    let last = |line: &Value| line["kind"] == "evaluation" && line["iteration"] == 6;
    change(&lines, third, |line| line["env_steps"] = 240.into());
    change(&lines, last, |line| line["mean"] = 1e6.into());
    let line = doubted(&folder, 1);
    assert!(line.contains("the evaluation of iteration 6 has mean "), "{line}");
    let text_of = fs::read_to_string(&lines).unwrap();
    fs::write(&lines, text_of.lines().skip(2).map(|line| format!("{line}\n")).collect::<String>())
        .unwrap();
    assert!(doubted(&folder, 1).contains("metrics.jsonl has no line of iteration 1"));

    let (folder, config) = changed("settings", "config.toml");
    let settings = fs::read_to_string(&config).unwrap();
    fs::write(&config, settings.replace("clip = 0.1\n", "clip = 0.2\n")).unwrap();
    assert!(doubted(&folder, 1).contains("these are not the run's settings"));

    let (folder, manifest) = changed("manifest", "manifest.json");
    let content = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, content.replace("\"seed\": 7", "\"seed\": 8")).unwrap();
    assert!(doubted(&folder, 1).contains("manifest.json is missing, or it has been changed"));

    let (folder, arrays) = changed("arrays", "checkpoints/iter_00000004/weights.safetensors");
    let mut bytes = fs::read(&arrays).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&arrays, bytes).unwrap();
    assert!(doubted(&folder, 1).contains("weights.safetensors has SHA-256"));

    // The policies of an earlier checkpoint, with hashes of their own.
    let (folder, place) = changed("policies", "checkpoints/iter_00000006");
    let mut loaded = checkpoint::load(&place).unwrap();
    let earlier = checkpoint::load(&checkpoint::place(&folder, 4)).unwrap();
    let settings = fs::read_to_string(place.join("config.toml")).unwrap();
    loaded.checkpoint.policy = earlier.checkpoint.policy;
    fs::remove_dir_all(&place).unwrap();
    loaded.copy_to(&folder, &settings).unwrap();
    let line = doubted(&folder, 1);
    assert!(line.contains("the policies in the checkpoint of iteration 6 have"), "{line}");
    assert!(line.contains("its weights make"), "{line}");
}

#[test]
fn a_start_of_another_run_or_none_is_found_in_one_line() {
    let runs = Runs::new();
    let run = runs.folder("run");
    train(&run, &["run.iterations=2"]);
    let starts = run.join("starts.jsonl");
    change(&starts, |_| true, |line| line["seed"] = 8.into());
    assert!(doubted(&run, 1).contains("starts.jsonl, line 1: seed is 8, manifest.json has 7"));
    fs::write(&starts, "").unwrap();
    let no_start = "starts.jsonl is missing or has no line";
    assert!(doubted(&run, 1).contains(no_start));
    let line = failed(&["pack", text(&run), "--out", text(&runs.folder("pack"))], 1);
    assert!(line.contains(no_start), "{line}");
}

/// Adds a copy of the last line of this kind in `metrics.jsonl`, for another iteration.
fn invent(run: &Path, kind: &str, iteration: u64) {
    let mut line = metrics(run, kind).pop().unwrap();
    line["iteration"] = iteration.into();
    let file = run.join("metrics.jsonl");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, format!("{text}{line}\n")).unwrap();
}

#[test]
fn an_invented_iteration_or_evaluation_is_found_in_one_line() {
    let runs = Runs::new();
    let run = runs.folder("run");
    train(&run, &[SIX]);
    for (kind, iteration, part) in [
        ("iteration", 7, "has a line of iteration 7, provenance.jsonl has iterations 1 to 6"),
        ("iteration", 0, "has a line of iteration 0,"),
        ("evaluation", 7, "has a line of iteration 7,"),
        ("evaluation", 5, "evaluation of iteration 5 has env_steps 400, metrics.jsonl has 480"),
    ] {
        let folder = copy(&run, runs.folder(&format!("{kind}-{iteration}")));
        invent(&folder, kind, iteration);
        // As if a resume had changed the settings of evaluations.
        let starts = folder.join("starts.jsonl");
        let start = fs::read_to_string(&starts).unwrap();
        fs::write(&starts, start.repeat(2)).unwrap();
        let line = doubted(&folder, 6);
        assert!(line.contains(part), "{line}");
    }
    let folder = copy(&run, runs.folder("other"));
    let first = |line: &Value| line["kind"] == "evaluation" && line["iteration"] == 0;
    let lines = folder.join("metrics.jsonl");
    change(&lines, first, |line| line["episodes"] = 0.into());
    assert!(doubted(&folder, 6).contains("metrics.jsonl has 0 episodes, expected 1 to 10000"));
    change(&lines, first, |line| line["kind"] = "other".into());
    assert!(doubted(&folder, 1).contains("metrics.jsonl has 1 lines of no known kind"));
}

#[test]
fn evaluations_are_verified_also_if_a_resume_changed_their_settings() {
    for (setting, made) in [
        ("evaluation.episodes=3", 4),
        // The evaluations before and after the checkpoint of iteration 4.
        ("evaluation.sampled=true", 4),
        ("evaluation.every_steps=80", 5),
    ] {
        let runs = Runs::new();
        let folder = runs.folder("run");
        train(&folder, &["run.iterations=4"]);
        succeeded(&["train", "--resume", text(&folder), SIX, setting]);
        let printed = succeeded(&whole(&folder));
        let last = format!(
            "6 of its 6 iterations and {made} of its {made} evaluations have the recorded results\n"
        );
        assert!(printed.ends_with(&last), "{setting}: {printed}");
    }
}

#[test]
fn no_temporary_folder_stays_after_a_second_signal() {
    let runs = Runs::new();
    let (folder, temporary) = (runs.folder("run"), runs.folder("temporary"));
    fs::create_dir(&temporary).unwrap();
    train(&folder, &["run.iterations=40", "checkpoint.every=40"]);
    let mut verify = command(&["verify", text(&folder)]);
    let mut verify = Background::start(verify.env("TMPDIR", &temporary));
    // Without actors it would wait for a long time.
    let cores = std::thread::available_parallelism().unwrap().get();
    let actors = children(verify.process.id(), cores);
    actors.iter().for_each(|actor| signal(*actor, "-STOP"));
    assert_eq!(temporary.read_dir().unwrap().count(), 1);
    verify.signal("-INT");
    verify.logs("stopping", 1);
    // Signals within half a second are one request.
    std::thread::sleep(Duration::from_millis(600));
    verify.signal("-INT");
    assert_eq!(verify.end().0, Some(130));
    actors.iter().for_each(|actor| signal(*actor, "-CONT"));
    assert_eq!(temporary.read_dir().unwrap().count(), 0);
}

#[test]
fn a_run_with_the_checkpoints_of_another_is_refused_in_one_line() {
    let runs = Runs::new();
    let (run, other, mixed) = (runs.folder("run"), runs.folder("other"), runs.folder("mixed"));
    train(&run, &SHORT);
    success(&mut command(&[
        "train",
        "cue-2x1",
        "run.iterations=1",
        "evaluation.every_steps=0",
        &format!("run.dir={}", text(&other)),
    ]));
    copy(&run, mixed.clone());
    fs::remove_dir_all(mixed.join("checkpoints")).unwrap();
    copy(&other.join("checkpoints"), mixed.join("checkpoints"));
    let checkpoint = mixed.join("checkpoints/iter_00000001");
    let onnx = runs.folder("onnx");
    for path in [&mixed, &checkpoint] {
        for arguments in [
            &["eval", text(path)][..],
            &["film", text(path)],
            &["record", text(path)],
            &["export", text(path), "--onnx", text(&onnx)],
            &["serve", text(path), "--listen=127.0.0.1:0"],
        ] {
            let line = failed(arguments, 1);
            assert!(line.contains("it belongs to another run"), "{arguments:?}: {line}");
        }
    }
}

#[test]
fn a_run_of_another_commit_is_verified_and_a_difference_names_both_commits() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let program = another_build(&runs.folder(""));
    let mut other = Command::new(&program);
    let own = tiny("train", &folder, &["run.iterations=2"]);
    success(other.args(own.get_args()));
    let own = succeeded(&["--version"]).trim_end().split_once(' ').unwrap().1.to_owned();
    let starts = fs::read_to_string(folder.join("starts.jsonl")).unwrap();
    let start: Value = serde_json::from_str(starts.lines().next().unwrap()).unwrap();
    let recorded = |key: &str| start[key].as_str().unwrap().to_owned();
    let other = format!("{}+{}", recorded("version"), recorded("git_commit"));
    assert_ne!(other, own);
    let printed = succeeded(&["verify", text(&folder)]);
    let builds = format!("computed by {other}; this is {own}");
    assert!(printed.contains(&builds), "{printed}");
    let lines = folder.join("metrics.jsonl");
    change(&lines, |line| line["iteration"] == 1, |line| line["env_steps"] = 1.into());
    let line = doubted(&folder, 2);
    let builds = format!("{other} computed the run, and this program is {own}");
    assert!(line.contains(&builds) && line.contains("may compute other numbers"), "{line}");
}

#[test]
fn a_run_in_an_external_environment_is_verified_while_that_is_there() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let service = CueService::start(Faults::NONE);
    let settings = ["task=cue-2x1", "run.iterations=4", "--environment", &service.url];
    success(&mut tiny("train", &folder, &settings));
    let printed = succeeded(&["verify", text(&folder)]);
    assert!(printed.contains("4 of its 4 iterations"), "{printed}");
    let url = service.url.clone();
    drop(service);
    let line = doubted(&folder, 1);
    let needed = format!("the program of its environment must run at {url}");
    assert!(line.contains(&needed), "{line}");
}
