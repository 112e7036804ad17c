//! Requests to an external environment program, and the validation of its answers.

use bytes::Bytes;

use crate::read::{array, bad_value, from_1_to, length, required};
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

    /// Reads a message sent to the environment `spec`.
    ///
    /// # Errors
    /// If a part is missing, the seed does not have 32 bytes, or actions have a wrong shape or are not finite.
    pub fn from_wire(wire: &wire::PlayRequest, spec: &EnvironmentSpec) -> Result<Self, Refusal> {
        Ok(match required(wire.request.as_ref(), "request")? {
            Request::Reset(reset) => {
                let seed = array(&reset.seed, "a seed", "reset.seed")?;
                Self::Reset { environment: reset.environment, seed }
            }
            Request::Restore(restore) => {
                Self::Restore { environment: restore.environment, state: restore.state.to_vec() }
            }
            Request::Save(save) => Self::Save { environment: save.environment },
            Request::Step(step) => {
                let sizes = spec.agents.iter();
                let sizes = sizes.map(|agent| (agent.name.as_str(), agent.action.size));
                let count = step.environments.len();
                let actions = columns(&step.actions, count, sizes, "step.actions")?;
                Self::Step { environments: step.environments.clone(), actions }
            }
        })
    }
}

impl View {
    /// Converts to an answer.
    #[must_use]
    pub fn to_wire(&self, count: usize) -> wire::PlayResponse {
        wire::PlayResponse { answer: Some(Answer::View(self.message(count))) }
    }

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

    fn message(&self, count: usize) -> wire::EnvironmentsView {
        wire::EnvironmentsView {
            observations: self
                .observations
                .iter()
                .map(|rows| tensor::in_rows(&[count], rows))
                .collect(),
            state: Some(tensor::in_rows(&[count], &self.state)),
        }
    }

    fn read(
        wire: &wire::EnvironmentsView,
        spec: &EnvironmentSpec,
        count: usize,
        field: &str,
    ) -> Result<Self, Refusal> {
        let sizes = spec.agents.iter().map(|agent| (agent.name.as_str(), agent.observation.len()));
        let observations =
            columns(&wire.observations, count, sizes, &format!("{field}.observations"))?;
        let shape = [count, spec.state.len()];
        let state = read_floats(wire.state.as_ref(), &shape, &format!("{field}.state"))?;
        Ok(Self { observations, state })
    }
}

impl Steps {
    /// Converts to an answer.
    #[must_use]
    pub fn to_wire(&self) -> wire::PlayResponse {
        let count = self.reward.len();
        let steps = wire::EnvironmentsSteps {
            view: Some(self.view.message(count)),
            reward: Some(tensor::floats(&[count], &self.reward)),
            terminated: Some(tensor::flags(&[count], &self.terminated)),
            truncated: Some(tensor::flags(&[count], &self.truncated)),
        };
        wire::PlayResponse { answer: Some(Answer::Steps(steps)) }
    }

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

/// For each agent `[count, size]`; `sizes` has the agents' names, which errors contain.
fn columns<'a>(
    tensors: &[wire::Tensor],
    count: usize,
    sizes: impl ExactSizeIterator<Item = (&'a str, usize)>,
    field: &str,
) -> Result<Vec<Vec<f32>>, Refusal> {
    length(tensors.len(), sizes.len(), field)?;
    let checked = tensors.iter().zip(sizes).enumerate().map(|(i, (tensor, (agent, size)))| {
        let named = |refusal: Refusal| {
            let detail = format!("{}, agent {agent}", refusal.detail);
            Refusal::new(refusal.reason, refusal.field, detail)
        };
        read_floats(Some(tensor), &[count, size], &format!("{field}[{i}]")).map_err(named)
    });
    checked.collect()
}
