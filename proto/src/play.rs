//! Requests to an external environment program, and the validation of its answers.

use bytes::Bytes;

use crate::read::{bad_value, from_1_to, length, required};
use crate::tensor::{self, read_flags, read_floats};
use crate::wire::play_request::Request;
use crate::wire::play_response::Answer;
use crate::{EnvironmentSpec, Reason, Refusal, wire};

/// A request to one or more environments.
#[derive(Clone, Debug, PartialEq)]
pub enum PlayRequest {
    /// Start an episode.
    Reset {
        /// Index of the environment.
        environment: u32,
        /// The only source of randomness of the episode.
        seed: [u8; 32],
    },
    /// Continue from a saved state.
    Restore {
        /// Index of the environment.
        environment: u32,
        /// The saved state.
        state: Vec<u8>,
    },
    /// Save the state.
    Save {
        /// Index of the environment.
        environment: u32,
    },
    /// Step each environment once.
    Step {
        /// `[n]`.
        environments: Vec<u32>,
        /// For each agent `[n, act]`.
        actions: Vec<Vec<f32>>,
    },
}

/// Observations and states of `n` environments.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// For each agent `[n, obs]`.
    pub observations: Vec<Vec<f32>>,
    /// `[n, S]`.
    pub state: Vec<f32>,
}

/// Result of a step of `n` environments.
#[derive(Clone, Debug, PartialEq)]
pub struct Steps {
    /// After the step, before any reset.
    pub view: View,
    /// `[n]`.
    pub reward: Vec<f32>,
    /// `[n]`: the episode reached a terminal state.
    pub terminated: Vec<bool>,
    /// `[n]`: the episode was truncated; never together with `terminated`.
    pub truncated: Vec<bool>,
}

impl PlayRequest {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::PlayRequest {
        let request = match self {
            Self::Reset { environment, seed } => Request::Reset(wire::ResetEnvironment {
                environment: *environment,
                seed: Bytes::copy_from_slice(seed),
            }),
            Self::Restore { environment, state } => Request::Restore(wire::RestoreEnvironment {
                environment: *environment,
                state: Bytes::copy_from_slice(state),
            }),
            Self::Save { environment } => {
                Request::Save(wire::SaveEnvironment { environment: *environment })
            }
            Self::Step { environments, actions } => Request::Step(wire::StepEnvironments {
                environments: environments.clone(),
                actions: actions
                    .iter()
                    .map(|rows| tensor::in_rows(&[environments.len()], rows))
                    .collect(),
            }),
        };
        wire::PlayRequest { request: Some(request) }
    }
}

impl View {
    /// Reads the answer to a reset or a restore.
    ///
    /// # Errors
    /// If it is another answer, a shape does not match `spec`, or a value is not finite.
    pub fn from_wire(wire: &wire::PlayResponse, spec: &EnvironmentSpec) -> Result<Self, Refusal> {
        match &wire.answer {
            Some(Answer::View(view)) => Self::read(view, spec, 1, "view"),
            other => Err(other_answer(other.as_ref(), "view")),
        }
    }

    fn read(
        wire: &wire::EnvironmentsView,
        spec: &EnvironmentSpec,
        count: usize,
        field: &str,
    ) -> Result<Self, Refusal> {
        let list = format!("{field}.observations");
        length(wire.observations.len(), spec.agents.len(), &list)?;
        let tensors = wire.observations.iter().zip(&spec.agents).enumerate();
        let observations = tensors.map(|(i, (tensor, agent))| {
            let named = |refusal: Refusal| {
                let detail = format!("{}, agent {}", refusal.detail, agent.name);
                Refusal::new(refusal.reason, refusal.field, detail)
            };
            let shape = [count, agent.observation.len()];
            read_floats(Some(tensor), &shape, &format!("{list}[{i}]")).map_err(named)
        });
        let observations = observations.collect::<Result<_, _>>()?;
        let shape = [count, spec.state.len()];
        let state = read_floats(wire.state.as_ref(), &shape, &format!("{field}.state"))?;
        Ok(Self { observations, state })
    }
}

impl Steps {
    /// Reads the answer to a step of `count` environments.
    ///
    /// # Errors
    /// If it is another answer, a shape does not match `spec`, a value is not finite, or an episode is both terminated
    /// and truncated.
    pub fn from_wire(
        wire: &wire::PlayResponse,
        spec: &EnvironmentSpec,
        count: usize,
    ) -> Result<Self, Refusal> {
        let wire = match &wire.answer {
            Some(Answer::Steps(steps)) => steps,
            other => return Err(other_answer(other.as_ref(), "steps")),
        };
        let view = required(wire.view.as_ref(), "steps.view")?;
        let steps = Self {
            view: View::read(view, spec, count, "steps.view")?,
            reward: read_floats(wire.reward.as_ref(), &[count], "steps.reward")?,
            terminated: read_flags(wire.terminated.as_ref(), &[count], "steps.terminated")?,
            truncated: read_flags(wire.truncated.as_ref(), &[count], "steps.truncated")?,
        };
        let mut flags = steps.terminated.iter().zip(&steps.truncated);
        match flags.position(|(terminated, truncated)| *terminated && *truncated) {
            None => Ok(steps),
            Some(at) => {
                let detail = format!("element {at} is also terminated");
                Err(Refusal::new(Reason::Inconsistent, "steps.truncated", detail))
            }
        }
    }
}

/// Reads the answer to a save.
///
/// # Errors
/// If it is another answer, or the state is empty or longer than `spec` allows.
pub fn saved_state(wire: &wire::PlayResponse, spec: &EnvironmentSpec) -> Result<Vec<u8>, Refusal> {
    let state = match &wire.answer {
        Some(Answer::Saved(saved)) => &saved.state,
        other => return Err(other_answer(other.as_ref(), "saved")),
    };
    from_1_to(spec.max_state_bytes as usize, state.len(), "bytes", "saved.state")?;
    Ok(state.to_vec())
}

fn other_answer(found: Option<&Answer>, expected: &str) -> Refusal {
    let found = match found {
        None => return Refusal::new(Reason::MissingField, "answer", "must be set"),
        Some(Answer::View(_)) => "view",
        Some(Answer::Steps(_)) => "steps",
        Some(Answer::Saved(_)) => "saved",
    };
    bad_value("answer", format!("{found}, expected {expected}"))
}
