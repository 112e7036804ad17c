//! Trained teams and their description.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use learner::store::run_folder::RunFolder;
use policy::{ActorPolicy, Head, PolicySnapshot};
use serde_json::{Value, json};
use sim::EnvironmentBatch;

use super::agents;
use crate::run::chosen::{ChosenArguments, Which};
use crate::run::pretrained::{TeamRecord, team_record};
use crate::run::stored::{self, Trained};
use crate::run::{pretrained, run_path};

/// The policies of the run in a folder, or those of a checkpoint's folder, and their description as JSON. `checkpoint` chooses
/// one as the option of the commands does.
///
/// # Errors
/// If there is no valid checkpoint, or the settings of the run are damaged.
pub fn trained(run: PathBuf, checkpoint: Option<&str>) -> anyhow::Result<(PolicySnapshot, String)> {
    let checkpoint = checkpoint.map(Which::from);
    let path = ChosenArguments { run: Some(run), checkpoint }.path()?;
    let record = path.to_str().filter(|_| !path.exists()).and_then(team_record);
    described(&path, stored::trained(&path)?, record)
}

/// The policies that come with the program for a task, and their description as JSON.
///
/// # Errors
/// If there are none.
pub fn pretrained(task: &str) -> anyhow::Result<(PolicySnapshot, String)> {
    let team = pretrained::of_task(task)?.with_context(|| {
        let known = pretrained::tasks().collect::<Vec<_>>().join(", ");
        format!("the program has no trained team for `{task}`; it has teams for {known}")
    });
    described(Path::new(task), team?.trained()?, team_record(task))
}

/// The policies of the run at `run`, and their description. A team of the program has a `record`.
fn described(
    run: &Path,
    trained: Trained,
    record: Option<&TeamRecord>,
) -> anyhow::Result<(PolicySnapshot, String)> {
    let config = &trained.config;
    // Another program's environment is not needed to act, so that program need not run.
    let simulated = config.environment.url.is_empty();
    let hosted = simulated.then(|| trained.environment()).transpose()?;
    let world = hosted.as_ref().map(|hosted| hosted.environment.as_ref());
    let spec = world.map(EnvironmentBatch::description);
    let policies = &trained.policy.agents;
    // Only the manifest has the description of another program's environment.
    let manifest = if simulated { None } else { RunFolder::recorded(&RunFolder::of(run)) };
    let agents =
        world.map_or_else(|| agents::of_policies(policies, manifest.as_ref()), agents::of_task);
    let agents = agents.into_iter().zip(policies).map(with_policy);
    let outside = || manifest.as_ref()?["task"].as_str().map(str::to_owned);
    let task = spec.map(|spec| spec.task.clone()).or_else(outside);
    let task = task.unwrap_or_else(|| config.resolved.text("task").to_owned());
    let description = json!({
        "run": run_path::name(&RunFolder::of(run)),
        "task": task,
        "algorithm": config.resolved.text("algorithm"),
        "seed": config.run.seed,
        "iteration": trained.iteration,
        "policy_sha256": trained.weights.digest.to_string(),
        "dt_secs": spec.map(|spec| spec.dt_secs),
        "record": record,
        "agents": agents.collect::<Vec<_>>(),
    });
    Ok((trained.policy, description.to_string()))
}

/// An agent with its policy.
fn with_policy((mut agent, policy): (Value, &ActorPolicy)) -> Value {
    let distribution = match policy.head() {
        Head::Gaussian | Head::SharedGaussian(_) => "gaussian",
        Head::Categorical { .. } => "categorical",
        Head::Deterministic { .. } => "clamped_gaussian",
        Head::Uniform { .. } => "uniform",
        Head::TanhGaussian { .. } => "tanh_gaussian",
    };
    agent["observation_size"] = policy.observation_size().into();
    agent["distribution"] = distribution.into();
    agent["hidden_size"] = policy.hidden_size().into();
    agent
}
