//! The trained teams that come with the program, one per task. A command takes the name of the task in place of a run.

use std::collections::BTreeMap;
use std::path::{Path, is_separator};
use std::sync::LazyLock;

use anyhow::Context as _;
use policy::PolicySnapshot;
use proto::{Digest, PolicyVersion, WeightsName};
use serde::{Deserialize, Serialize};
use sim::spelling::nearest;

use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::run::run_path;
use crate::run::stored::Trained;

/// Where a team comes from: a run of its task with the default settings of an algorithm.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TeamRecord {
    /// Algorithm of the run.
    pub(crate) algorithm: String,
    /// Seed of the run.
    pub(crate) seed: u64,
    /// Iterations of the run.
    pub(crate) iteration: u64,
    /// Environment steps of the run.
    pub(crate) env_steps: u64,
    /// Mean return of the ten episodes of the run's last evaluation.
    pub(crate) return_mean: f64,
    /// Standard deviation of these ten returns.
    pub(crate) return_standard_deviation: f64,
    /// Return of the first of these episodes.
    pub(crate) first_return: f64,
    /// Hash of the run's semantic settings, hexadecimal.
    pub(crate) settings_sha256: String,
    /// Hash of the run's final weights, critics included, hexadecimal.
    pub(crate) weights_sha256: String,
    /// Hash of the team's file, hexadecimal.
    pub(crate) policy_sha256: String,
    /// Commit of the program that trained it.
    pub(crate) commit: String,
}

macro_rules! teams {
    ($($task:literal),+ $(,)?) => {
        &[$(($task, include_bytes!(concat!("../../pretrained/", $task, ".safetensors")).as_slice())),+]
    };
}

/// Task and policies of each team, as actors get them.
const TEAMS: &[(&str, &[u8])] = teams!(
    "halfcheetah-2x3",
    "halfcheetah-3x2",
    "halfcheetah-6x1",
    "walker2d-2x3",
    "walker2d-3x2",
    "walker2d-6x1",
    "ant-2x4",
    "ant-4x2",
    "ant-8x1",
    "halfcheetah-pushed-2x3",
    "walker2d-pushed-2x3",
    "ant-pushed-4x2",
    "quadruped-4x3",
    "carry-light-2x2",
    "carry-heavy-2x2",
);

/// The record of each team by its task.
static RECORDS: LazyLock<BTreeMap<String, TeamRecord>> = LazyLock::new(|| {
    let text = include_str!("../../pretrained/teams.toml");
    toml::from_str(text).expect("a test shows that the file has a record for each team")
});

/// The record of the team for a task; `None` if the program has no team for it.
pub(crate) fn team_record(task: &str) -> Option<&'static TeamRecord> {
    RECORDS.get(task)
}

/// A team that comes with the program.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PretrainedTeam {
    task: &'static str,
    /// Its encoded policies.
    policies: &'static [u8],
}

/// The team that a command's argument names; `None` if it is a path.
///
/// # Errors
/// As of [`of_task`]; or it is the path of nothing, and no path of a folder in another one.
pub(crate) fn named(run: &Path) -> anyhow::Result<Option<PretrainedTeam>> {
    let Some(name) = run.to_str().filter(|_| !run.exists()) else { return Ok(None) };
    let team = of_task(name)?;
    if team.is_none() && !name.contains(is_separator) {
        let tasks = tasks().collect::<Vec<_>>().join(", ");
        let why = match run_path::meant(run) {
            Some(run) => format!("did you mean `{}`?", run.display()),
            None => format!("tasks with a trained team are {tasks}"),
        };
        let why = format!("`{name}` is neither a folder nor a task with a trained team; {why}");
        return Err(Usage::new(why).into());
    }
    Ok(team)
}

/// Names of the tasks with a team.
pub(crate) fn tasks() -> impl Iterator<Item = &'static str> {
    TEAMS.iter().map(|(task, _)| *task)
}

/// The team for a task; `None` if the name is like that of no task.
///
/// # Errors
/// The program has no team for the task, or the name is that of a team with typing errors.
pub(crate) fn of_task(name: &str) -> anyhow::Result<Option<PretrainedTeam>> {
    if let Some((task, policies)) = TEAMS.iter().find(|(task, _)| *task == name) {
        return Ok(Some(PretrainedTeam { task, policies }));
    }
    let all = sim::task_names();
    let meant = nearest(name, tasks()).or_else(|| nearest(name, all.iter().copied()));
    let why = match (all.contains(&name), meant) {
        (true, _) => format!(
            "the program has no trained team for `{name}`; train one with `s2mia train {name}` and name its folder"
        ),
        (false, Some(task)) => {
            format!("`{name}` is neither a folder nor a task; did you mean `{task}`?")
        }
        (false, None) => return Ok(None),
    };
    Err(Usage::new(why).into())
}

impl PretrainedTeam {
    /// Its policies with the settings of their run.
    pub(crate) fn trained(self) -> anyhow::Result<Trained> {
        let Self { task, policies } = self;
        let TeamRecord { ref algorithm, seed, iteration, env_steps, .. } = RECORDS[task];
        let (algorithm, seed) = (format!("algorithm={algorithm}"), format!("run.seed={seed}"));
        let config = RunConfig::with(&[task, &algorithm, &seed])?;
        let digest = Digest::of(policies);
        let policy =
            PolicySnapshot::from_bytes(policies).context("cannot read the team's policies")?;
        let weights = WeightsName { version: PolicyVersion(iteration), digest };
        Ok(Trained { config, iteration, env_steps, policy, weights })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proto::ActionChoice;

    use super::*;
    use crate::run::offered::RunEnvironment;
    use crate::run::stored;

    #[test]
    fn every_file_is_in_the_program_and_has_a_record() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("pretrained");
        let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let files = paths.filter(|path| path.extension().unwrap() == "safetensors");
        let files = files.map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned());
        let inside: BTreeSet<String> = TEAMS.iter().map(|(task, _)| (*task).to_owned()).collect();
        assert_eq!(files.collect::<BTreeSet<_>>(), inside);
        assert_eq!(RECORDS.keys().cloned().collect::<BTreeSet<_>>(), inside);
    }

    #[test]
    fn every_team_has_the_settings_the_weights_and_the_return_of_its_record() {
        for (task, record) in &*RECORDS {
            let trained = stored::trained(Path::new(task)).unwrap();
            let settings = policy::arrays::hex(&trained.config.resolved.sha256());
            assert_eq!(settings, record.settings_sha256, "{task}");
            assert_eq!(trained.weights.digest.to_string(), record.policy_sha256, "{task}");
            let mut hosted = RunEnvironment::of(&trained.config).unwrap();
            let start = (trained.episode(0).key(), ActionChoice::Mean);
            let world = hosted.environment.as_mut();
            let played = rollout::play_episode(world, &trained.policy, start, |_| {}).unwrap();
            assert_eq!(played.extrinsic_return, record.first_return, "{task}");
        }
    }
}
