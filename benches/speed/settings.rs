//! The program's settings, as resolved by the program itself.

use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, ensure};
use learner::launch::Launch;
use learner::lease::end_states::StateReader;
use marl::{ObservationScale, Problem};
use policy::RunSeed;
use proto::Digest;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// The crates' settings of one run.
#[derive(Clone)]
pub(crate) struct CaseSettings {
    pub(crate) task: sim::TaskConfig,
    pub(crate) policy: policy::PolicyConfig,
    pub(crate) training: marl::TrainingConfig,
    pub(crate) learner: learner::config::LearnerConfig,
}

/// Path of the program, built with the same profile.
pub(crate) fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(arguments);
    command
}

/// Settings of a core in addition to `preset=harl`, which is meant for `mlp`; HARL trains recurrent cores
/// in chunks of 10.
pub(crate) fn core(name: &str) -> &'static [&'static str] {
    match name {
        "gru" => &["policy.core=gru", "policy.backpropagation_steps=10"],
        _ => &["policy.core=mlp"],
    }
}

impl CaseSettings {
    /// The settings of HARL's preset for a task, with changes.
    pub(crate) fn harl(task: &str, changes: &[&[&str]]) -> anyhow::Result<Self> {
        Self::of(&[&[task, "preset=harl"], changes.concat().as_slice()].concat())
    }

    /// The settings as `s2mia config` resolves them, with slots of two environments unless `arguments` set another number.
    pub(crate) fn of(arguments: &[&str]) -> anyhow::Result<Self> {
        let mut config = program(&[&["config"], arguments].concat());
        let output = config.env("S2MIA__ENVIRONMENTS__PER_SLOT", "2").output()?;
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        ensure!(output.status.success(), "s2mia config {arguments:?}: {message}");
        let resolved: Table = String::from_utf8(output.stdout)?.parse()?;
        let task = sections(&resolved, &["task", "observation"])?;
        let mut training = vec!["update", "critic", "surprise", "influence", "maddpg"];
        training.extend(resolved.contains_key("hasac").then_some("hasac"));
        let learner = ["environments", "lease", "audit", "evaluation", "checkpoint", "learner"];
        Ok(Self {
            task: typed(task)?,
            policy: typed(resolved["policy"].clone())?,
            training: typed(sections(&resolved, &training)?)?,
            learner: typed(sections(&resolved, &learner)?)?,
        })
    }

    /// Creates `count` environments of the task.
    pub(crate) fn world(&self, count: usize) -> anyhow::Result<Box<dyn sim::EnvironmentBatch>> {
        Ok(sim::environments(&self.task, count)?)
    }

    /// The task's sizes for a learning rule.
    pub(crate) fn problem(&self) -> anyhow::Result<Problem> {
        let world = self.world(1)?;
        Ok(learner::train::assemble::problem(world.description()))
    }

    /// The decoder of the task's states.
    pub(crate) fn decoder(&self) -> anyhow::Result<StateReader> {
        let bounds = self.world(1)?.state_bounds().cloned().context("the task has no states")?;
        Ok(StateReader::new(move |state| match sim::State::from_bytes(state, &bounds) {
            Ok(state) => Ok(state.position),
            Err(error) => Err(error.to_string()),
        }))
    }

    /// A new run in `folder`, without evaluations and with only the last checkpoint.
    pub(crate) fn launch(&self, folder: &Path, iterations: usize) -> anyhow::Result<Launch> {
        let mut config = self.learner.clone();
        config.evaluation.every_steps = 0;
        config.checkpoint.every = iterations as u64;
        let world = self.world(1)?;
        Ok(Launch {
            config,
            training: self.training.clone(),
            observations: ObservationScale::AsShown,
            policy: self.policy.clone(),
            environment: world.description().clone(),
            task_settings: serde_json::to_string(&self.task)?,
            states: self.decoder()?,
            divergence_remedy: String::new(),
            seed: RunSeed(1),
            iterations: iterations as u64,
            until: iterations as u64,
            run_id: "speed".to_owned(),
            folder: folder.to_path_buf(),
            config_toml: String::new(),
            command: String::new(),
            config_sha256: Digest([0; 32]),
            build: "test".to_owned(),
            rollout_fingerprint: rollout::rollout_fingerprint(),
            manifest: serde_json::json!({}),
            resume: false,
            start: None,
            evaluations: None,
        })
    }
}

fn sections(resolved: &Table, names: &[&str]) -> anyhow::Result<Table> {
    let one = |name: &&str| {
        let section = resolved.get(*name).with_context(|| format!("no setting {name}"))?;
        Ok(((*name).to_owned(), section.clone()))
    };
    names.iter().map(one).collect()
}

fn typed<T: DeserializeOwned>(table: impl Into<Value>) -> anyhow::Result<T> {
    Ok(table.into().try_into()?)
}
