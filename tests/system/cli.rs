//! The command line: invalid input gives one line on stderr and status 2.

use std::process::Command;

use crate::commands::{failed, refused};
use crate::runs::s2mia;

#[test]
fn invalid_settings_give_one_line_and_status_two() {
    for (arguments, part) in [
        (&["train", "update.lerning_rate=1"][..], "did you mean `update.learning_rate`?"),
        (&["train", "update.gamma=2"], "update.gamma"),
        (&["train", "run.dir="], "`run.dir`: it is empty; without it the run gets a new folder"),
        (
            &["train", "run.dir=Cargo.toml"],
            "Cargo.toml is no folder; run.dir names the run's folder",
        ),
        (&["train", "update.gamma=much"], "must be a finite number"),
        (&["train", "halfcheeta-2x3"], "did you mean `halfcheetah-2x3`?"),
        (&["train", "algorithm=happ"], "did you mean `happo`?"),
        (
            &["train", "run.seed=-1"],
            "`run.seed`: invalid value: integer `-1`, expected a whole number from 0",
        ),
        (&["train", "evaluation.episodes=5e9"], "expected a whole number from 0 to 4294967295"),
        (&["train", "--seed", "3"], "a setting is written run.seed=VALUE"),
        (&["train", "run.seed=7", "walker2d-2x3"], "the task comes first"),
        (&["train", "halfcheetah-2x3", "happo"], "is no setting"),
        (&["train", "--config", "no/such/file.toml"], "no/such/file.toml"),
        (&["train", "--resume", "no/such/run"], "no/such/run"),
        (&["train", "--frobnicate"], "--frobnicate"),
        (&["learner", "--listen", "0.0.0.0:0"], "--insecure-allow-remote"),
        (&["learner", "--listen", "here"], "--listen"),
        (&["actor", "--learner", "localhost"], "--learner"),
        (&["actor", "--learner", "http://10.0.0.1:50051"], "--insecure-allow-remote"),
        (&["actor", "--learner", "https://localhost:50051"], "--tls-ca"),
        (&["learner", "--tls-certificate", "a.pem"], "--tls-client-ca"),
        (&["inspect", "no/such/run"], "no/such/run"),
        (&["status", "no/such/run"], "no/such/run"),
        (&["stop", "no/such/run"], "no/such/run"),
        (&["watch", "no/such/run"], "no/such/run"),
        (&["watch", "--max-outage-secs=-1"], "--max-outage-secs"),
        (&["stop", "https://localhost:1"], "--tls-ca"),
        (&["eval", "no/such/run"], "no/such/run"),
        (&["record", "no/such/run"], "no/such/run"),
        (&["serve", "no/such/run"], "no/such/run"),
        (&["plot", "no/such/run"], "no/such/run"),
        (&["dance"], "dance"),
    ] {
        let line = refused(arguments);
        assert!(line.contains(part), "{arguments:?}: {line}");
    }
}

#[test]
fn an_environment_variable_is_a_setting_and_is_named_if_invalid() {
    let run = |name: &str, value: &str| {
        Command::new(env!("CARGO_BIN_EXE_s2mia")).arg("config").env(name, value).output().unwrap()
    };
    let good = String::from_utf8(run("S2MIA__UPDATE__CLIP", "0.125").stdout).unwrap();
    assert!(good.contains("clip = 0.125  # environment variable S2MIA__UPDATE__CLIP"), "{good}");
    let bad = run("S2MIA__UPDATE__CLAP", "0.125");
    assert_eq!(bad.status.code(), Some(2));
    assert!(String::from_utf8(bad.stderr).unwrap().contains("S2MIA__UPDATE__CLAP: unknown key"));
    let alike = String::from_utf8(run("S2MIA_RUN_SEED", "3").stderr).unwrap();
    let line = "error: environment variable S2MIA_RUN_SEED is no setting; write S2MIA__RUN__SEED\n";
    assert_eq!(alike, line);
}

#[test]
fn commands_that_read_runs_reject_a_folder_without_one() {
    let empty = tempfile::tempdir().unwrap();
    let path = empty.path().to_str().unwrap();
    for command in ["eval", "record", "film", "plot", "inspect", "status", "serve", "watch"]
        .map(|name| vec![name, path])
    {
        let line = refused(&command);
        assert!(line.contains("is no run folder: it has no config.toml"), "{command:?}: {line}");
    }
    let line = refused(&["train", "--resume", path]);
    assert!(line.contains("is no run folder: it has no config.toml"), "{line}");
}

#[test]
fn a_run_without_a_checkpoint_is_reported_with_the_command_that_restarts_it() {
    let folder = tempfile::tempdir().unwrap();
    let settings = s2mia(&["config", "cue-2x1", "run.iterations=3"]).stdout;
    std::fs::write(folder.path().join("config.toml"), settings).unwrap();
    let path = folder.path().to_str().unwrap();
    let again = format!("`s2mia train --resume {path}` begins it again");
    let status = String::from_utf8(s2mia(&["status", path]).stdout).unwrap();
    assert_eq!(status, format!("{path} stopped before its first checkpoint; {again}\n"));
    let told: serde_json::Value =
        serde_json::from_slice(&s2mia(&["status", path, "--json"]).stdout).unwrap();
    let expected =
        serde_json::json!({"state": "stopped", "iteration": 0, "iterations": 3, "env_steps": 0});
    assert_eq!(told, expected);
    let line = failed(&["eval", path], 1);
    assert!(line.contains("has no checkpoint yet") && line.contains(&again), "{line}");
}

#[test]
fn every_command_has_help() {
    for command in [
        "train", "learner", "actor", "serve", "health", "certs", "eval", "record", "film", "plot",
        "inspect", "status", "watch", "stop", "tasks", "config",
    ] {
        let output = s2mia(&[command, "--help"]);
        assert!(output.status.success(), "{command}");
        assert!(String::from_utf8(output.stdout).unwrap().contains("Usage: s2mia"), "{command}");
    }
}

#[test]
fn the_tasks_are_listed_with_their_agents() {
    let output = s2mia(&["tasks", "--json"]);
    let tasks: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let six = tasks.as_array().unwrap().iter().find(|t| t["task"] == "halfcheetah-6x1").unwrap();
    assert_eq!(six["agents"].as_array().unwrap().len(), 6);
    assert_eq!(six["agents"][0]["action"]["size"], 1);
    let joints = |name: &str| {
        let task = tasks.as_array().unwrap().iter().find(|t| t["task"] == name).unwrap();
        let agents = task["agents"].as_array().unwrap().iter();
        agents.map(|agent| agent["joints"].to_string().replace('"', "")).collect::<Vec<_>>()
    };
    let opposite = ["[hip_1,ankle_1,hip_3,ankle_3]", "[hip_2,ankle_2,hip_4,ankle_4]"];
    assert_eq!(joints("ant-2x4d"), opposite);
    assert_eq!(joints("ant-2x4")[0], "[hip_4,ankle_4,hip_1,ankle_1]");
    let table = String::from_utf8(s2mia(&["tasks"]).stdout).unwrap();
    assert!(table.contains("halfcheetah-2x3: 2 agents"), "{table}");
    assert!(table.contains("one choice among 3"), "{table}");
}
