//! Builds a trainer from the settings of a run: a new one, or one that resumes from the newest valid checkpoint.

use std::path::PathBuf;

use marl::{ObservationMoments, ObservationScale, Surprise};
use policy::{PolicyConfig, RunSeed};
use proto::{Digest, EnvironmentSpec, Incarnation, PROTOCOL_VERSION, RunDescription};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::{Value, json};

use crate::config::LearnerConfig;
use crate::error::LearnerError;
use crate::lease::end_states::StateReader;
use crate::lease::sample::random_number;
use crate::observe::metrics::Metrics;
use crate::store::checkpoint::{self, CheckpointError, Loaded};
use crate::store::run_folder::{RunFolder, RunFolderError, demand_config};
use crate::train::assemble::problem;
use crate::train::environments::Environments;
use crate::train::evaluation::Evaluations;
use crate::train::fail_points;
use crate::train::provenance::Provenance;
use crate::train::trainer::{Trainer, policy_bytes};

/// The settings of a run and the parts of the program that it needs.
#[derive(Clone, Debug)]
pub struct Launch {
    /// Environments, leases, evaluation, checkpoints, threads.
    pub config: LearnerConfig,
    /// The learning rule.
    pub training: marl::TrainingConfig,
    /// How the learner scales observations.
    pub observations: ObservationScale,
    /// The actor networks.
    pub policy: PolicyConfig,
    /// The environment, which every actor must have.
    pub environment: EnvironmentSpec,
    /// JSON from which an actor builds the environment.
    pub task_settings: String,
    /// Decodes the environment's states.
    pub states: StateReader,
    /// What helps if simulated environments diverge; empty for external ones.
    pub divergence_remedy: String,
    /// Every random draw comes from it.
    pub seed: RunSeed,
    /// Iterations of the whole run.
    pub iterations: u64,
    /// Names the run.
    pub run_id: String,
    /// The run folder.
    pub folder: PathBuf,
    /// All settings, for the run folder.
    pub config_toml: String,
    /// Hash of the semantic settings.
    pub config_sha256: Digest,
    /// The numeric fingerprint that every actor must have.
    pub rollout_fingerprint: Digest,
    /// Version and commit of the program.
    pub build: String,
    /// An object with more fields for the run folder's manifest.
    pub manifest: Value,
    /// Whether to resume the run in the folder.
    pub resume: bool,
}

impl Launch {
    /// Checks that the run can be described to actors; touches no file. The settings have been checked.
    ///
    /// # Errors
    /// Names the field of the description that is invalid, such as a message that is too large.
    pub fn validate(&self) -> Result<(), LearnerError> {
        self.description(Incarnation(0)).validate().map_err(|refusal| {
            LearnerError::Other(format!(
                "the run cannot be described to actors; the field of the message is {refusal}"
            ))
        })
    }

    /// The description that actors would get if a slot had one environment.
    #[must_use]
    pub fn smallest_description(&self) -> RunDescription {
        self.with_slots_of(1, Incarnation(0))
    }

    /// The description of this start of the run for actors. Slots are as large as its messages allow.
    fn description(&self, incarnation: Incarnation) -> RunDescription {
        let sizes = self.config.environments.slot_sizes();
        let fits = |size: &usize| self.with_slots_of(*size, incarnation).validate().is_ok();
        let most = sizes.iter().find(|size| fits(size)).or(sizes.last());
        self.with_slots_of(most.copied().unwrap_or(1), incarnation)
    }

    fn with_slots_of(&self, size: usize, incarnation: Incarnation) -> RunDescription {
        let environments = &self.config.environments;
        let hidden = self.policy.hidden_size() as u32;
        RunDescription {
            run_id: self.run_id.clone(),
            protocol_version: PROTOCOL_VERSION,
            incarnation,
            seed: self.seed.0,
            task_settings: self.task_settings.clone(),
            environment: self.environment.clone(),
            environments_per_slot: size as u32,
            slot_steps: environments.steps as u32,
            chunk_steps: environments.message_steps as u32,
            hidden_sizes: vec![hidden; self.environment.agents.len()],
            hidden_every: self.policy.backpropagation_steps as u32,
            rollout_fingerprint: self.rollout_fingerprint,
            config_sha256: self.config_sha256,
            heartbeat_secs: self.config.lease.heartbeat_secs(),
            settings_toml: self.config_toml.clone(),
            build: self.build.clone(),
            other_builds: self.config.learner.other_builds,
            sampled_evaluations: self.config.evaluation.sampled,
            restores_observations: true,
        }
    }

    /// The manifest of the run folder.
    pub(crate) fn manifest(&self) -> Value {
        let mut manifest = self.manifest.as_object().cloned().unwrap_or_default();
        let own = json!({
            "run_id": self.run_id,
            "seed": self.seed.0,
            "environment": self.environment.task,
            "config_sha256": self.config_sha256.to_string(),
            "rollout_fingerprint": self.rollout_fingerprint.to_string(),
            "checkpoint_schema": checkpoint::SCHEMA,
            "protocol_version": PROTOCOL_VERSION,
        });
        manifest.extend(own.as_object().cloned().unwrap_or_default());
        Value::Object(manifest)
    }
}

/// Claims the run folder and builds the trainer; nothing is overwritten unless everything fits.
///
/// # Errors
/// Names a folder that is taken, in use or of another run, and a checkpoint that does not fit.
pub fn prepare(launch: Launch) -> Result<(Trainer, RunDescription), LearnerError> {
    fail_points::demand_known();
    launch.validate()?;
    let folder = claim(&launch)?;
    let resumed = newest(&launch, &folder)?;
    let iteration = resumed.as_ref().map_or(0, |loaded| loaded.checkpoint.iteration);
    if iteration > launch.iterations {
        let path = resumed.map_or_else(PathBuf::new, |loaded| loaded.path);
        return Err(LearnerError::Other(format!(
            "{} stands at iteration {iteration}, past the {} that this run should have",
            path.display(),
            launch.iterations
        )));
    }
    folder.begin(&launch.config_toml, &launch.manifest())?;
    let description = launch.description(Incarnation(random_number()));
    let mut trainer = build(launch, folder, &description, iteration)?;
    if let Some(loaded) = resumed {
        trainer.restore(&loaded.checkpoint)?;
        trainer.begin_invalid_again(&loaded.path);
        trainer.saved = Some(loaded.saved());
    }
    Ok((trainer, description))
}

fn claim(launch: &Launch) -> Result<RunFolder, RunFolderError> {
    if launch.resume {
        RunFolder::claim_existing(&launch.folder, &launch.config_sha256.to_string())
    } else {
        RunFolder::claim_new(&launch.folder)
    }
}

/// The checkpoint to resume from; `None` for a new run, and for one that ended before its first.
fn newest(launch: &Launch, folder: &RunFolder) -> Result<Option<Loaded>, LearnerError> {
    if !launch.resume {
        return Ok(None);
    }
    let loaded = match checkpoint::load_newest(folder.path()) {
        Err(CheckpointError::None { folder }) => {
            tracing::warn!("{} holds no checkpoint: the run begins again", folder.display());
            return Ok(None);
        }
        loaded => loaded?,
    };
    for (path, reason) in &loaded.skipped {
        tracing::error!("{} is damaged and skipped: {reason}", path.display());
    }
    let from = loaded.checkpoint.iteration;
    let whole = loaded.skipped.is_empty();
    let latest = checkpoint::named_latest(&checkpoint::folder(folder.path()));
    if let Some(latest) = latest.filter(|at| *at > from && whole) {
        let path = loaded.path.display();
        tracing::error!(
            "the checkpoint of iteration {latest} is lost; the run continues from {path}"
        );
    }
    let expected = launch.config_sha256.to_string();
    demand_config(&loaded.path, &loaded.manifest.config_sha256, &expected)?;
    Ok(Some(loaded))
}

/// A trainer before the first iteration, whose metrics and provenance reach to `iteration`.
fn build(
    launch: Launch,
    folder: RunFolder,
    description: &RunDescription,
    iteration: u64,
) -> Result<Trainer, LearnerError> {
    let pool = pool(launch.config.learner.threads)?;
    let problem = problem(&launch.environment);
    let algorithm =
        pool.install(|| marl::build(&launch.training, &launch.policy, &problem, launch.seed))?;
    let observations = ObservationMoments::new(launch.observations, &problem);
    let environments = &launch.config.environments;
    let (metrics, measured) = Metrics::open(folder.path(), iteration)?;
    Ok(Trainer {
        surprise: Surprise::new(&launch.training.surprise, &problem, launch.seed)?,
        environments: Environments::fresh(description, environments.count, environments.phase),
        evaluations: Evaluations::new(
            launch.config.evaluation.clone(),
            environments.steps_per_iteration(),
            launch.iterations,
            measured,
        ),
        states: launch.states,
        divergence_remedy: launch.divergence_remedy,
        config_sha256: launch.config_sha256,
        settings_toml: launch.config_toml,
        last_iteration: launch.iterations,
        policy: policy_bytes(algorithm.as_ref(), &observations)?,
        observations,
        algorithm,
        decay: launch.training.update.learning_rate_decay,
        iteration: 0,
        provenance: Provenance::open(folder.path(), iteration)?,
        folder,
        metrics,
        saved: None,
        failed_saves: 0,
        pool,
        config: launch.config,
    })
}

/// Number of threads; 0 stands for one per core. rayon would read `RAYON_NUM_THREADS` instead.
fn thread_count(threads: usize) -> usize {
    match threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads,
    }
}

fn pool(threads: usize) -> Result<ThreadPool, LearnerError> {
    let name = |index| format!("update-{index}");
    ThreadPoolBuilder::new().num_threads(thread_count(threads)).thread_name(name).build().map_err(
        |error| LearnerError::Other(format!("cannot start the pool of update threads: {error}")),
    )
}

#[cfg(test)]
mod tests {
    use super::thread_count;

    #[test]
    fn no_number_of_threads_stands_for_one_per_core() {
        let cores = std::thread::available_parallelism().expect("a machine with cores").get();
        assert_eq!((thread_count(0), thread_count(3)), (cores, 3));
    }
}
