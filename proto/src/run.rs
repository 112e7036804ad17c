//! Description of a run for actors, and the sizes of its messages.

use bytes::Bytes;

use crate::name::printable;
use crate::read::{bad_value, digest, length, positive, required, seconds};
use crate::{Digest, EnvironmentSpec, Incarnation, MAX_MESSAGE_BYTES, Refusal, wire};

/// Bytes of a message reserved for everything but tensors: headers, shapes, field names.
const MESSAGE_OVERHEAD_BYTES: u64 = 16 << 10;

/// Description of a run, which an actor needs before its first lease.
#[derive(Clone, Debug, PartialEq)]
pub struct RunDescription {
    /// Human-readable name of the run.
    pub run_id: String,
    /// The learner's [`crate::PROTOCOL_VERSION`].
    pub protocol_version: u32,
    /// This start of the learner.
    pub incarnation: Incarnation,
    /// Seed of every random draw.
    pub seed: u64,
    /// The task's settings as JSON, for environments built into the actor; empty if an external program provides
    /// the environment.
    pub task_settings: String,
    /// The environment that every actor must have.
    pub environment: EnvironmentSpec,
    /// Largest `E`: environments of a slot. Each lease has its own number.
    pub environments_per_slot: u32,
    /// Steps of each environment in one slot.
    pub slot_steps: u32,
    /// Steps of one chunk; divides `slot_steps`.
    pub chunk_steps: u32,
    /// `H` of each agent, 0 without a recurrent state.
    pub hidden_sizes: Vec<u32>,
    /// Steps between two stored recurrent states; divides `chunk_steps`.
    pub hidden_every: u32,
    /// SHA-256 of the probes of simulator and policy on the learner's machine.
    pub rollout_fingerprint: Digest,
    /// SHA-256 of the settings that affect results.
    pub config_sha256: Digest,
    /// Seconds between two heartbeats.
    pub heartbeat_secs: f64,
    /// The run's resolved settings as TOML, for logs.
    pub settings_toml: String,
    /// The learner's version and commit.
    pub build: String,
    /// Whether actors of other builds may register if their fingerprint is the run's.
    pub other_builds: bool,
    /// Whether evaluation episodes use sampled actions.
    pub sampled_evaluations: bool,
    /// Whether the learner restores observations that a chunk leaves out.
    pub restores_observations: bool,
}

impl RunDescription {
    /// Chunks of one slot.
    #[must_use]
    pub fn chunks_per_slot(&self) -> u32 {
        self.slot_steps / self.chunk_steps
    }

    /// Checks that sizes are consistent and that chunks and leases fit in a message. After this check, products of sizes
    /// cannot overflow.
    ///
    /// # Errors
    /// Names the invalid field.
    pub fn validate(&self) -> Result<(), Refusal> {
        let agents = self.environment.agents.len();
        self.environment.check("run.environment")?;
        positive(self.environment.max_state_bytes.into(), "run.environment.max_state_bytes")?;
        positive(self.environments_per_slot.into(), "run.environments_per_slot")?;
        divides(self.chunk_steps, self.slot_steps, "run.chunk_steps")?;
        length(self.hidden_sizes.len(), agents, "run.hidden_sizes")?;
        divides(self.hidden_every, self.chunk_steps, "run.hidden_every")?;
        seconds(self.heartbeat_secs, "run.heartbeat_secs")?;
        fits(self.largest_message_bytes(), "run.chunk_steps")?;
        fits(self.max_boundary_bytes(), "run.environments_per_slot")
    }

    /// Most bytes of a chunk or a lease in a message.
    pub const MESSAGE_LIMIT_BYTES: u64 = MAX_MESSAGE_BYTES as u64 - MESSAGE_OVERHEAD_BYTES;

    /// Bytes of the largest chunk or lease, which must not exceed [`Self::MESSAGE_LIMIT_BYTES`]; `None` if the number
    /// overflows.
    #[must_use]
    pub fn largest_message_bytes(&self) -> Option<u64> {
        // It is a chunk in which every step ends an episode. It has the states of the slot's end, which are as large as
        // those of a lease.
        let [mut observed, mut acted] = [self.environment.state.len() as u64, 2];
        for agent in &self.environment.agents {
            observed = observed.checked_add(agent.observation.len() as u64)?;
            acted = acted.checked_add(agent.action.size as u64 + 1)?;
        }
        // Observations and states are in the rows and again in the final steps.
        let floats = observed.checked_mul(2)?.checked_add(acted)?;
        let rows = u64::from(self.chunk_steps).checked_mul(self.environments_per_slot.into())?;
        let stored = rows.div_ceil(self.hidden_every.into()).checked_mul(self.hidden())?;
        let total = rows.checked_mul(floats.checked_add(2)?)?.checked_add(stored)?;
        let tensors = total.checked_mul(4)?.checked_add(self.max_boundary_bytes()?)?;
        let terms = u64::from(self.environments_per_slot)
            .checked_mul(8 * self.environment.reward_terms.len() as u64)?;
        tensors.checked_add(terms)
    }

    /// Bytes of the states in a lease or at a slot's end.
    fn max_boundary_bytes(&self) -> Option<u64> {
        let state = u64::from(self.environment.max_state_bytes);
        let each = self.hidden().checked_mul(4)?.checked_add(state)?;
        each.checked_mul(self.environments_per_slot.into())
    }

    fn hidden(&self) -> u64 {
        self.hidden_sizes.iter().map(|size| u64::from(*size)).sum()
    }

    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::RunDescription {
        wire::RunDescription {
            run_id: self.run_id.clone(),
            protocol_version: self.protocol_version,
            incarnation: self.incarnation.0,
            seed: self.seed,
            task_settings: self.task_settings.clone(),
            environment: Some(self.environment.to_wire()),
            environments_per_slot: self.environments_per_slot,
            slot_steps: self.slot_steps,
            chunk_steps: self.chunk_steps,
            hidden_sizes: self.hidden_sizes.clone(),
            hidden_every: self.hidden_every,
            rollout_fingerprint: Bytes::copy_from_slice(&self.rollout_fingerprint.0),
            config_sha256: Bytes::copy_from_slice(&self.config_sha256.0),
            heartbeat_secs: self.heartbeat_secs,
            settings_toml: self.settings_toml.clone(),
            build: self.build.clone(),
            other_builds: self.other_builds,
            sampled_evaluations: self.sampled_evaluations,
            restores_observations: self.restores_observations,
        }
    }

    /// Reads the message.
    ///
    /// # Errors
    /// If a part is missing, or as [`Self::validate`].
    pub fn from_wire(wire: Option<wire::RunDescription>) -> Result<Self, Refusal> {
        let wire = required(wire, "run")?;
        let environment = required(wire.environment, "run.environment")?;
        let run = Self {
            run_id: printable(&wire.run_id),
            protocol_version: wire.protocol_version,
            incarnation: Incarnation(wire.incarnation),
            seed: wire.seed,
            task_settings: wire.task_settings,
            environment: EnvironmentSpec::from_wire(environment, "run.environment")?,
            environments_per_slot: wire.environments_per_slot,
            slot_steps: wire.slot_steps,
            chunk_steps: wire.chunk_steps,
            hidden_sizes: wire.hidden_sizes,
            hidden_every: wire.hidden_every,
            rollout_fingerprint: digest(&wire.rollout_fingerprint, "run.rollout_fingerprint")?,
            config_sha256: digest(&wire.config_sha256, "run.config_sha256")?,
            heartbeat_secs: wire.heartbeat_secs,
            settings_toml: wire.settings_toml,
            build: printable(&wire.build),
            other_builds: wire.other_builds,
            sampled_evaluations: wire.sampled_evaluations,
            restores_observations: wire.restores_observations,
        };
        run.validate()?;
        Ok(run)
    }
}

fn divides(part: u32, whole: u32, field: &str) -> Result<(), Refusal> {
    if part > 0 && whole > 0 && whole.is_multiple_of(part) {
        return Ok(());
    }
    Err(bad_value(field, format!("{part} does not divide {whole} steps")))
}

fn fits(bytes: Option<u64>, field: &str) -> Result<(), Refusal> {
    let max = RunDescription::MESSAGE_LIMIT_BYTES;
    match bytes {
        Some(bytes) if bytes <= max => Ok(()),
        Some(bytes) => {
            let detail =
                format!("a message could have {bytes} bytes, the limit is {max}: reduce it");
            Err(bad_value(field, detail))
        }
        None => Err(bad_value(field, "the size of a message overflows")),
    }
}
