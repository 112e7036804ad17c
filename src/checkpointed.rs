//! A run's newest good checkpoint, as commands read it.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use learner::checkpoint::{CheckpointError, Loaded};
use policy::{Key, PolicySnapshot, RunSeed};

use crate::run_config::RunConfig;
use crate::run_path::config_file_of_run;

/// A trained policy with the settings of its run.
pub(crate) struct Trained {
    /// Settings of the run.
    pub(crate) config: RunConfig,
    /// The checkpoint it comes from.
    pub(crate) iteration: u64,
    /// Environment steps until then.
    pub(crate) env_steps: u64,
    /// All agents.
    pub(crate) policy: PolicySnapshot,
}

impl Trained {
    /// Where the run's own evaluation of this policy begins its episode `episode`.
    pub(crate) fn start(&self, episode: u32) -> Key {
        Key::of_evaluation(RunSeed(self.config.run.seed), self.iteration, episode)
    }
}

/// The newest checkpoint whose hashes are right; refuses a run that has none yet.
pub(crate) fn load(run: &Path) -> anyhow::Result<Loaded> {
    let shown = run.display();
    load_if_any(run)?.with_context(|| {
        format!("{shown} has no checkpoint yet; if it has stopped, `s2mia train --resume {shown}` begins it again")
    })
}

/// The same, or `None` before the first; tells of every newer one that it had to pass over.
pub(crate) fn load_if_any(run: &Path) -> anyhow::Result<Option<Loaded>> {
    config_file_of_run(run)?;
    let loaded = match learner::checkpoint::load_newest(run) {
        Err(CheckpointError::None { .. }) => return Ok(None),
        loaded => loaded.with_context(|| format!("{} has no good checkpoint", run.display()))?,
    };
    for (path, why) in &loaded.skipped {
        tracing::warn!("{} is damaged and passed over: {why}", path.display());
    }
    Ok(Some(loaded))
}

/// The newest policy of a run.
pub(crate) fn trained(run: &Path) -> anyhow::Result<Trained> {
    let loaded = load(run)?;
    let config = RunConfig::of_run(run)?;
    let policy = PolicySnapshot::from_bytes(&loaded.checkpoint.policy)
        .with_context(|| format!("cannot read the policy in {}", loaded.path.display()))?;
    let (iteration, env_steps) = (loaded.checkpoint.iteration, loaded.checkpoint.env_steps);
    Ok(Trained { config, iteration, env_steps, policy })
}

/// What tells later from which run and policy something was made.
pub(crate) fn metadata(trained: &Trained, task: &str) -> BTreeMap<String, String> {
    let resolved = &trained.config.resolved;
    BTreeMap::from([
        ("task".to_owned(), task.to_owned()),
        ("algorithm".to_owned(), resolved.text("algorithm").to_owned()),
        ("seed".to_owned(), trained.config.run.seed.to_string()),
        ("iteration".to_owned(), trained.iteration.to_string()),
        ("env_steps".to_owned(), trained.env_steps.to_string()),
        ("config_sha256".to_owned(), policy::arrays::hex(&resolved.sha256())),
    ])
}
