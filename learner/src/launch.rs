//! The settings of a run, and its description for actors that follows from them.

use std::path::PathBuf;

use marl::{Algorithm, MarlError, ObservationMoments, ObservationScale};
use policy::{PolicyConfig, PolicySnapshot, RunSeed};
use proto::{Digest, EnvironmentSpec, Incarnation, PROTOCOL_VERSION, RunDescription};
use serde_json::{Value, json};

use crate::config::LearnerConfig;
use crate::error::LearnerError;
use crate::lease::end_states::StateReader;
use crate::store::checkpoint;
use crate::train::assemble::problem;
use crate::train::evaluation::PlannedEvaluations;

/// What training changes, before the first iteration.
pub(crate) type FirstState = (Box<dyn Algorithm>, ObservationMoments);

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
    /// Iteration after which this start of the learner ends; that of the whole run, unless a part of it is computed.
    pub until: u64,
    /// Names the run.
    pub run_id: String,
    /// The run folder.
    pub folder: PathBuf,
    /// All settings, for the run folder.
    pub config_toml: String,
    /// Command that begins a run with the same settings, for the page.
    pub command: String,
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
    /// An encoded [`PolicySnapshot`] from which training begins; `None`: from policies that the seed draws, or a checkpoint.
    pub start: Option<Vec<u8>>,
    /// The evaluations of a run that is computed again, in the place of those that the settings schedule.
    pub evaluations: Option<PlannedEvaluations>,
}

impl Launch {
    /// Checks that the run can be described to actors and can begin from its policies; touches no file. The settings have been
    /// checked.
    ///
    /// # Errors
    /// Names the field of the description that is invalid, such as a message that is too large, or what differs between the
    /// policies and the run.
    pub fn validate(&self) -> Result<(), LearnerError> {
        if self.start.is_some() {
            self.first_state()?;
        }
        self.description(Incarnation(0)).validate().map_err(|refusal| {
            LearnerError::Other(format!(
                "the run cannot be described to actors; the field of the message is {refusal}"
            ))
        })
    }

    /// The algorithm and the statistics of observations before the first iteration.
    ///
    /// # Errors
    /// If the policies from which training begins are damaged or differ from those of the run.
    pub(crate) fn first_state(&self) -> Result<FirstState, LearnerError> {
        let problem = problem(&self.environment);
        let mut algorithm = marl::build(&self.training, &self.policy, &problem, self.seed)?;
        let mut observations = ObservationMoments::new(self.observations, &problem);
        if let Some(bytes) = &self.start {
            let policies = PolicySnapshot::from_bytes(bytes).map_err(MarlError::from)?;
            let floor = self.policy.sigma_floor;
            let agents = policies.agents.iter().map(|agent| agent.with_sigma_from(floor));
            let agents = agents.collect::<Result<_, _>>().map_err(MarlError::from)?;
            let policies = PolicySnapshot { agents };
            marl::start_from(algorithm.as_mut(), &policies)?;
            observations.start_from(&policies)?;
        }
        Ok((algorithm, observations))
    }

    /// The description that actors would get if a slot had one environment.
    #[must_use]
    pub fn smallest_description(&self) -> RunDescription {
        self.with_slots_of(1, Incarnation(0))
    }

    /// The description of this start of the run for actors. Slots are as large as its messages allow.
    pub(crate) fn description(&self, incarnation: Incarnation) -> RunDescription {
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
            hidden_every: self.training.sequence_steps(&self.policy) as u32,
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
