//! What the folder of a run has stored: its settings, which are `config.toml` or a checkpoint's copy if that file is damaged, and
//! its newest valid checkpoint, or the one that is named instead of a run.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow, ensure};
use learner::lease::published;
use learner::store::checkpoint::{CheckpointError, Loaded};
use learner::store::run_folder::{CONFIG, MANIFEST, RunFolder, STARTS};
use learner::store::{checkpoint, plain_file};
use policy::{PolicySnapshot, RunSeed};
use proto::{AgentSpec, Digest, PolicyVersion, WeightsName};
use rollout::EvaluationEpisode;

use crate::config::ConfigError;
use crate::config::run_config::RunConfig;
use crate::process::shell;
use crate::run::offered::RunEnvironment;
use crate::run::pretrained;
use crate::run::recorded::all_lines;
use crate::run::run_path::demand_run;
use crate::run::{BUILD, build_of};

/// The file with the settings of the run in `folder`, and what it says: `config.toml`, or the newest checkpoint's copy if
/// `config.toml` is damaged or has other semantic settings than the run.
pub(crate) fn settings_of_run(folder: &Path) -> Result<(PathBuf, RunConfig), ConfigError> {
    let own = own_settings(folder);
    let Err(why) = own else { return own.map(|config| (folder.join(CONFIG), config)) };
    let loaded = match learner::store::checkpoint::load_newest(folder) {
        Ok(loaded) => loaded,
        Err(CheckpointError::None { .. }) if is_of_this_build(folder) => {
            let remedy =
                "no checkpoint has a copy: restore the file, or begin the run in another folder";
            return Err(ConfigError::Other(format!("{why}; {remedy}")));
        }
        Err(_) => return Err(why),
    };
    let copy = loaded.path.join(learner::store::checkpoint::SETTINGS);
    let config = settings_in(&copy).map_err(|_| why.clone())?;
    tracing::warn!("{why}; the settings in {} are used", copy.display());
    Ok((copy, config))
}

/// What `config.toml` of the run in `folder` says, which must be the settings of the run.
pub(crate) fn own_settings(folder: &Path) -> Result<RunConfig, ConfigError> {
    let file = folder.join(CONFIG);
    let read = settings_in(&file).map_err(|error| of_another_version(folder, error));
    read.and_then(|config| unchanged(&file, folder, config))
}

/// The settings in a file of a run, which must be a plain file: a pipe would block.
pub(crate) fn settings_in(file: &Path) -> Result<RunConfig, ConfigError> {
    match plain_file::refusal(file) {
        None => RunConfig::of_file(file),
        Some(why) => Err(ConfigError::at(file.display(), why)),
    }
}

/// The configuration of the run in `folder`.
pub(crate) fn config_of_run(folder: &Path) -> Result<RunConfig, ConfigError> {
    settings_of_run(folder).map(|(_, config)| config)
}

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
}

impl Trained {
    /// Episode `index` of the run's own evaluation of this policy.
    pub(crate) fn episode(&self, index: u32) -> EvaluationEpisode {
        EvaluationEpisode { seed: RunSeed(self.config.run.seed), iteration: self.iteration, index }
    }

    /// The environment of the run; refuses one with other agents or sizes than those of the policies.
    pub(crate) fn environment(&self) -> anyhow::Result<RunEnvironment> {
        let hosted = RunEnvironment::of(&self.config)?;
        let agents = &hosted.environment.description().agents;
        published::demand_sizes(&self.policy, agents, &self.hidden_sizes(agents))
            .map_err(|why| anyhow!("the policies are not for the run's environment: {why}"))?;
        Ok(hosted)
    }

    /// Sizes of the recurrent states of these agents in the run.
    pub(crate) fn hidden_sizes(&self, agents: &[AgentSpec]) -> Vec<u32> {
        vec![self.config.policy.hidden_size() as u32; agents.len()]
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

/// The newest policy of a run, or the trained team of a task that `run` names.
pub(crate) fn trained(run: &Path) -> anyhow::Result<Trained> {
    if let Some(team) = pretrained::named(run)? {
        return team.trained();
    }
    let loaded = load(run)?;
    let (file, config) = settings_of_run(run)?;
    demand_own_checkpoint(run, &loaded, (&file, &config))?;
    let policy = PolicySnapshot::from_bytes(&loaded.checkpoint.policy)
        .with_context(|| format!("cannot read the policy in {}", loaded.path.display()))?;
    let (iteration, env_steps) = (loaded.checkpoint.iteration, loaded.checkpoint.env_steps);
    let digest = Digest::of(&loaded.checkpoint.policy);
    let weights = WeightsName { version: PolicyVersion(iteration), digest };
    Ok(Trained { config, iteration, env_steps, policy, weights })
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
        ("config_sha256".to_owned(), policy::arrays::hex(&resolved.sha256())),
    ])
}

/// Refuses a checkpoint with other settings than those in the file at `run`, or than those of the run around it.
pub(crate) fn demand_own_checkpoint(
    run: &Path,
    loaded: &Loaded,
    (file, config): (&Path, &RunConfig),
) -> anyhow::Result<()> {
    let folder = RunFolder::of(run);
    let manifest = RunFolder::recorded(&folder).unwrap_or_default();
    let recorded = manifest["config_sha256"].as_str().map(str::to_owned);
    let resolved = policy::arrays::hex(&config.resolved.sha256());
    let own = &loaded.manifest.config_sha256;
    for (place, expected) in [(file, Some(resolved)), (&folder.join(MANIFEST), recorded)] {
        let expected = expected.as_ref().unwrap_or(own);
        ensure!(
            expected == own,
            "the settings of the checkpoint {} have the SHA-256 {own}, those of {} have {expected}: it belongs to another run, or \
             another version of the program made the run",
            loaded.path.display(),
            place.display()
        );
    }
    Ok(())
}

/// Refuses settings with another hash than the run's manifest records, or the last line of its starts if it has none.
fn unchanged(file: &Path, folder: &Path, config: RunConfig) -> Result<RunConfig, ConfigError> {
    let last = || all_lines(&folder.join(STARTS)).ok()?.pop();
    let manifest = RunFolder::recorded(folder).map(|manifest| (MANIFEST, manifest));
    let recorded = manifest.or_else(|| Some((STARTS, last()?)));
    let found = policy::arrays::hex(&config.resolved.sha256());
    let expected = recorded
        .as_ref()
        .and_then(|(name, record)| Some((name, record["config_sha256"].as_str()?)));
    match expected {
        Some((name, expected)) if expected != found => {
            let detail = format!(
                "these are not the run's settings: their SHA-256 is {found}, {name} has {expected}"
            );
            Err(ConfigError::at(file.display(), detail))
        }
        _ => Ok(config),
    }
}

/// Whether the run in `folder` is not known to be of another version or commit.
fn is_of_this_build(folder: &Path) -> bool {
    RunFolder::recorded(folder).is_none_or(|manifest| build_of(&manifest) == BUILD)
}

/// Explains a key in a run's own settings that this program does not know, if another version or commit made the run.
fn of_another_version(folder: &Path, error: ConfigError) -> ConfigError {
    let (ConfigError::UnknownKey { place, key, .. }, Some(manifest)) =
        (&error, RunFolder::recorded(folder))
    else {
        return error;
    };
    if is_of_this_build(folder) {
        return error;
    }
    let recorded = |field: &str| manifest[field].as_str().unwrap_or("unknown").to_owned();
    let (version, commit) = (recorded("version"), recorded("git_commit"));
    let detail = format!(
        "unknown key `{key}`: another version made the run, {version}, commit {commit}; train again"
    );
    ConfigError::at(place, detail)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Request, layers};

    #[test]
    fn without_a_manifest_settings_must_be_those_of_the_last_start() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let resolved = layers::resolve(&Request::default()).unwrap();
        std::fs::write(path(CONFIG), resolved.to_toml()).unwrap();
        let own = policy::arrays::hex(&resolved.sha256());
        let starts = |last: &str| {
            let lines = format!("{{\"config_sha256\":\"aa\"}}\n{{\"config_sha256\":\"{last}\"}}\n");
            std::fs::write(path(STARTS), lines).unwrap();
        };
        starts(&own);
        own_settings(folder.path()).unwrap();
        starts("bb");
        let error = own_settings(folder.path()).unwrap_err().to_string();
        assert!(error.ends_with("starts.jsonl has bb"), "{error}");
    }

    #[test]
    fn an_unknown_key_in_the_settings_of_a_run_names_the_version_that_made_it() {
        let resolved = layers::resolve(&Request::default()).unwrap();
        let text = resolved.to_toml().replace("[critic]\n", "[critic]\ninput = \"state\"\n");
        let folder = tempfile::tempdir().unwrap();
        let start = serde_json::json!({"version": "0.0.1", "git_commit": "abc"});
        RunFolder::claim_new(folder.path()).unwrap().begin(&text, &start).unwrap();
        let refusal = settings_of_run(folder.path()).unwrap_err().to_string();
        let expected = "config.toml: unknown key `critic.input`: another version made the run, 0.0.1, commit abc; train again";
        assert!(refusal.ends_with(expected), "{refusal}");
    }
}
