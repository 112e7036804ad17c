//! The newest valid checkpoint of a run, or the one that is named instead of a run.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use learner::store::checkpoint::{self, CheckpointError, Loaded};
use policy::{PolicySnapshot, RunSeed};
use proto::{Digest, PolicyVersion, WeightsName};
use rollout::EvaluationEpisode;

use crate::config::run_config::RunConfig;
use crate::config::run_settings::config_of_run;
use crate::process::shell;
use crate::run::run_path::demand_run;

/// A trained policy with the settings of its run.
pub(crate) struct Trained {
    /// Settings of the run.
    pub(crate) config: RunConfig,
    /// Iteration of its checkpoint.
    pub(crate) iteration: u64,
    /// Environment steps before that checkpoint.
    pub(crate) env_steps: u64,
    /// The policies of all agents.
    pub(crate) policy: PolicySnapshot,
    /// Name of their weights.
    pub(crate) weights: WeightsName,
    /// Hash of the run's semantic settings.
    pub(crate) config_sha256: String,
}

impl Trained {
    /// Episode `index` of the run's own evaluation of this policy.
    pub(crate) fn episode(&self, index: u32) -> EvaluationEpisode {
        EvaluationEpisode { seed: RunSeed(self.config.run.seed), iteration: self.iteration, index }
    }
}

/// Loads the newest checkpoint with correct hashes, or the checkpoint at `run`; refuses a run without any.
pub(crate) fn load(run: &Path) -> anyhow::Result<Loaded> {
    load_if_any(run)?.with_context(|| {
        let shown = run.display();
        let run = shell::path(run);
        format!("{shown} has no checkpoint yet; if it has stopped, `s2mia train --resume {run}` begins it again")
    })
}

/// As [`load`], but `None` before the first checkpoint. Logs every newer checkpoint that is damaged.
pub(crate) fn load_if_any(run: &Path) -> anyhow::Result<Option<Loaded>> {
    demand_run(run)?;
    if checkpoint::is_checkpoint(run) {
        return Ok(Some(checkpoint::load(run)?));
    }
    let loaded = match checkpoint::load_newest(run) {
        Err(CheckpointError::None { .. }) => return Ok(None),
        loaded => loaded.with_context(|| format!("{} has no valid checkpoint", run.display()))?,
    };
    for (path, why) in &loaded.skipped {
        tracing::warn!("{} is damaged and skipped: {why}", path.display());
    }
    Ok(Some(loaded))
}

/// The newest policy of a run.
pub(crate) fn trained(run: &Path) -> anyhow::Result<Trained> {
    let loaded = load(run)?;
    let config = config_of_run(run)?;
    let policy = PolicySnapshot::from_bytes(&loaded.checkpoint.policy)
        .with_context(|| format!("cannot read the policy in {}", loaded.path.display()))?;
    let (iteration, env_steps) = (loaded.checkpoint.iteration, loaded.checkpoint.env_steps);
    let digest = Digest::of(&loaded.checkpoint.policy);
    let weights = WeightsName { version: PolicyVersion(iteration), digest };
    let config_sha256 = loaded.manifest.config_sha256;
    Ok(Trained { config, iteration, env_steps, policy, weights, config_sha256 })
}

/// Metadata that identifies the run and the policy of a file.
pub(crate) fn metadata(trained: &Trained, task: &str) -> BTreeMap<String, String> {
    let resolved = &trained.config.resolved;
    BTreeMap::from([
        ("task".to_owned(), task.to_owned()),
        ("algorithm".to_owned(), resolved.text("algorithm").to_owned()),
        ("seed".to_owned(), trained.config.run.seed.to_string()),
        ("iteration".to_owned(), trained.iteration.to_string()),
        ("env_steps".to_owned(), trained.env_steps.to_string()),
        ("config_sha256".to_owned(), trained.config_sha256.clone()),
    ])
}
