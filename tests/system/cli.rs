//! The command line: invalid input gives one line on stderr and status 2.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt as _;

use serde_json::{Value, json};

use crate::runs::{Runs, command, failed, failure, refused, status, succeeded, success, text};

#[test]
fn invalid_arguments_give_one_line_and_status_two() {
    for (arguments, part) in [
        (&["train", "update.lerning_rate=1"][..], "did you mean `update.learning_rate`?"),
        (&["train", "update.gamma=2"], "update.gamma"),
        (&["train", "update.gamma=much"], "must be a finite number"),
        (&["train", "run.dir="], "`run.dir`: it is empty; without it the run gets a new folder"),
        (
            &["train", "run.dir=Cargo.toml"],
            "Cargo.toml is no folder; run.dir names the run's folder",
        ),
        (
            &["train", "run.seed=-1"],
            "`run.seed`: invalid value: integer `-1`, expected a whole number that is not negative",
        ),
        (
            &["train", "evaluation.episodes=5e9"],
            "expected a whole number that is not negative, up to 4294967295",
        ),
        (&["train", "--seed", "3"], "a setting is written run.seed=VALUE"),
        (&["train", "--config", "no/such/file.toml"], "no/such/file.toml"),
        (&["learner", "--listen", "0.0.0.0:0"], "--insecure-allow-remote"),
        (&["learner", "--listen", "here"], "--listen"),
        (&["actor", "--learner", "localhost"], "--learner"),
        (&["actor", "--learner", "http://10.0.0.1:50051"], "--insecure-allow-remote"),
        (&["actor", "--learner", "https://localhost:50051"], "--tls-ca"),
        (&["actor", "--log-dir", "x", "--log-episodes", "some"], "none, evaluation, all or a"),
        (&["learner", "--tls-certificate", "a.pem"], "--tls-client-ca"),
        (&["watch", "--max-outage-secs=-1"], "--max-outage-secs"),
        (
            &["health", "--timeout-secs", "-1"],
            "--timeout-secs <SECONDS>': must be 0 to 1000000000 s",
        ),
        (&["stop", "https://localhost:1"], "--tls-ca"),
        (&["stop", "no/such/run"], "no/such/run"),
        (&["status", "http://"], "`http://` is not a URL such as http://HOST:50051"),
        (&["watch", "ftp://x:1"], "it begins with neither http:// nor https://"),
        (&["stop", "127.0.0.1:99999"], "the port 99999 is not a number from 0 to 65535"),
        (&["health", "--learner", "localhost:1"], "is not a URL such as http://HOST:50051"),
    ] {
        let line = refused(arguments);
        assert!(line.contains(part), "{arguments:?}: {line}");
    }
}

#[test]
fn arguments_that_are_no_text_are_named_where_text_is_needed() {
    let name = OsStr::from_bytes(b"runs/a\xff");
    for words in [&["task", "check"][..], &["task", "new"], &["train"], &["status"]] {
        let line = failure(command(words).arg(name), 2);
        let expected = "error: \"runs/a\\xFF\" is not UTF-8, which this argument must be;";
        assert!(line.starts_with(expected), "{words:?}: {line}");
    }
}

#[test]
fn an_invalid_token_in_the_environment_gives_one_line_and_status_two() {
    for arguments in [&["stop", "http://127.0.0.1:1"][..], &["actor"], &["learner"]] {
        for token in ["", "abc"] {
            let line = failure(command(arguments).env("S2MIA_TOKEN", token), 2);
            let expected = "cannot use S2MIA_TOKEN: a token has 64 hexadecimal digits";
            assert!(line.contains(expected), "{arguments:?}: {line}");
        }
    }
}

#[test]
fn a_key_is_explained_with_its_value_origin_default_and_effect() {
    let lines = succeeded(&["config", "ant-4x2", "surprise.alpha", "lease.ttl_secs"]);
    let [alpha, lease] =
        [5, 10].map(|end| lines.lines().take(end).skip(end - 5).collect::<Vec<_>>());
    assert!(
        alpha[0].starts_with("surprise.alpha = 0.")
            && alpha[1].ends_with("configs/algorithms/happo-s2mia.toml"),
        "{alpha:?}"
    );
    assert_eq!(alpha[2], "  default  0.0");
    assert!(alpha[3].starts_with("  meaning  weight of log p_theta(o)"), "{alpha:?}");
    assert_eq!(lease[4], "  effect   affects no result of the steps that are trained");
    let own = succeeded(&["config", "hasac.batch"]);
    assert!(
        own.starts_with(
            "hasac.batch = not set\n  set by   nothing; no effect: it needs algorithm = hasac\n  \
             default  256\n"
        ),
        "{own}"
    );
    let optional = succeeded(&["config", "policy.noise"]);
    let start = "policy.noise = not set\n  set by   nothing (a run has it only if it is given)\n  default  \"independent\"\n";
    assert!(optional.starts_with(start), "{optional}");
    let unknown = refused(&["config", "surprise.alfa"]);
    assert!(
        unknown.trim_end().ends_with("unknown key `surprise.alfa`; did you mean `surprise.alpha`?"),
        "{unknown}"
    );
}

#[test]
fn commands_that_read_runs_refuse_what_is_none() {
    let runs = Runs::new();
    let empty = runs.folder("empty");
    std::fs::create_dir(&empty).unwrap();
    for reader in [
        "eval",
        "record",
        "film",
        "plot",
        "inspect",
        "status",
        "serve",
        "watch",
        "stop",
        "train --resume",
        "verify",
        "pack",
    ] {
        let words: Vec<&str> = reader.split(' ').collect();
        let line = refused(&[&words[..], &["no/such/run"]].concat());
        assert!(line.contains("no/such/run"), "{reader}: {line}");
        let line = refused(&[&words[..], &[text(&empty)]].concat());
        assert!(line.contains("is no run folder: it has no config.toml"), "{reader}: {line}");
    }
}

#[test]
fn an_environment_variable_is_a_setting_and_is_named_if_invalid() {
    let (good, _) = success(command(&["config"]).env("S2MIA__UPDATE__CLIP", "0.125"));
    assert!(good.contains("clip = 0.125  # environment variable S2MIA__UPDATE__CLIP"), "{good}");
    let bad = failure(command(&["config"]).env("S2MIA__UPDATE__CLAP", "0.125"), 2);
    assert!(bad.contains("S2MIA__UPDATE__CLAP: unknown key"), "{bad}");
}

#[test]
fn a_printed_configuration_can_be_read_with_the_same_hash() {
    let runs = Runs::new();
    // HASAC has a section that no other algorithm has.
    for algorithm in ["algorithm=happo", "algorithm=hasac"] {
        let first = succeeded(&["config", "halfcheetah-6x1", algorithm, "run.seed=9"]);
        let path = runs.folder("mine.toml");
        std::fs::write(&path, &first).unwrap();
        let again = succeeded(&["config", "--config", text(&path)]);
        let hash = |text: &str| text.lines().last().unwrap().to_owned();
        assert!(hash(&first).starts_with("# config_sha256 = "));
        assert_eq!(hash(&again), hash(&first));
    }
}

#[test]
fn a_run_without_a_checkpoint_is_reported_with_the_command_that_restarts_it() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    std::fs::create_dir(&folder).unwrap();
    let settings = succeeded(&["config", "cue-2x1", "run.iterations=3"]);
    std::fs::write(folder.join("config.toml"), settings).unwrap();
    let path = text(&folder);
    let line = failed(&["status", path], 2);
    assert!(line.contains("is no run folder: it has no manifest.json"), "{line}");
    // A learner that is killed before its first checkpoint leaves this file.
    std::fs::write(folder.join("learner.lock"), "").unwrap();
    let again = format!("`s2mia train --resume {path}` begins it again");
    let line = format!("{path} stopped before its first checkpoint; {again}\n");
    assert_eq!(succeeded(&["status", path]), line);
    let expected = json!({"state": "stopped", "iteration": 0, "iterations": 3, "env_steps": 0});
    assert_eq!(status(path), expected);
    let line = failed(&["eval", path], 1);
    assert!(line.contains("has no checkpoint yet") && line.contains(&again), "{line}");
    succeeded(&["train", "--resume", path, "run.actors=1", "--page", "off"]);
    assert_eq!(status(path)["state"], "finished");
}

#[test]
fn the_tasks_are_listed_with_their_agents() {
    let tasks: Value = serde_json::from_str(&succeeded(&["tasks", "--json"])).unwrap();
    let six = tasks.as_array().unwrap().iter().find(|t| t["task"] == "halfcheetah-6x1").unwrap();
    let agents = six["agents"].as_array().unwrap();
    assert_eq!((agents.len(), &agents[0]["action"]["size"]), (6, &json!(1)));
    assert_eq!(agents[0]["joints"].as_array().unwrap().len(), 1);
    let table = succeeded(&["tasks"]);
    assert!(table.contains("halfcheetah-2x3: 2 agents"), "{table}");
    assert!(table.contains("one choice among 3"), "{table}");
}
