//! Small runs with real processes.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Settings of a small run: 4 environments x 20 steps, two slots, small networks.
pub(crate) const TINY: &[&str] = &[
    "halfcheetah-6x1",
    "run.seed=7",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.message_steps=10",
    "policy.encoder=8",
    "policy.hidden=8",
    "critic.width=16",
    "influence.encoder=8",
    "influence.hidden=8",
    "update.epochs=2",
    "critic.epochs=2",
    "influence.epochs=2",
    "evaluation.every_steps=160",
    "evaluation.episodes=1",
    "checkpoint.every=2",
];

pub(crate) fn s2mia(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_s2mia")).args(arguments).output().unwrap()
}

pub(crate) fn succeeded(arguments: &[&str]) -> String {
    let output = s2mia(arguments);
    let (out, err) = (String::from_utf8(output.stdout).unwrap(), output.stderr);
    assert!(output.status.success(), "{arguments:?}\n{out}\n{}", String::from_utf8_lossy(&err));
    out
}

/// [`TINY`] without the settings that have no effect with the settings `more`.
pub(crate) fn tiny(more: &[&str]) -> Vec<&'static str> {
    let has = |setting: &str| more.contains(&setting);
    let mut without = Vec::new();
    if has("algorithm=maddpg") {
        without.extend(["policy.", "influence.", "update.epochs", "critic.epochs"]);
    }
    if has("algorithm=mappo") {
        without.push("influence.");
    }
    if has("policy.core=mlp") {
        without.extend(["policy.encoder", "policy.hidden"]);
    }
    let has_effect = |setting: &&&str| !without.iter().any(|key| setting.starts_with(key));
    TINY.iter().filter(has_effect).copied().collect()
}

pub(crate) fn train(folder: &Path, more: &[&str]) -> String {
    let dir = format!("run.dir={}", folder.display());
    succeeded(&[&["train"], &tiny(more)[..], &[dir.as_str()], more].concat())
}

pub(crate) fn inspect(folder: &Path) -> serde_json::Value {
    serde_json::from_str(&succeeded(&["inspect", folder.to_str().unwrap(), "--json"])).unwrap()
}

pub(crate) struct Runs(tempfile::TempDir);

impl Runs {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn folder(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}
