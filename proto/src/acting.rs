//! Requests to trained policies and their answers. `validate/acting.rs` checks received steps.

use crate::read::required;
use crate::{Reason, Refusal, WeightsName, tensor, wire};

/// How actions are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionChoice {
    /// The mean, or the likeliest choice.
    Mean,
    /// Sampled from the distribution.
    Sampled {
        /// Seed of the draws.
        seed: u64,
    },
}

/// Observations of some agents.
#[derive(Clone, Debug, PartialEq)]
pub struct ActStep {
    /// Whether a new episode starts.
    pub reset: bool,
    /// Agent index and observation `[obs]`; each agent at most once.
    pub observations: Vec<(usize, Vec<f32>)>,
}

/// The answer to a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Acted {
    /// The weights that acted.
    pub weights: WeightsName,
    /// Agent index and action `[act]`, before clamping.
    pub actions: Vec<(usize, Vec<f32>)>,
}

impl ActionChoice {
    /// The first message of a stream.
    #[must_use]
    pub fn to_wire(self) -> wire::ActRequest {
        let choice = match self {
            Self::Mean => wire::act_start::Choice::Mean(wire::MeanAction {}),
            Self::Sampled { seed } => {
                wire::act_start::Choice::Sampled(wire::SampledAction { seed })
            }
        };
        let start = wire::ActStart { choice: Some(choice) };
        wire::ActRequest { content: Some(wire::act_request::Content::Start(start)) }
    }

    /// Reads the first message of a stream.
    ///
    /// # Errors
    /// If it is another message, or the choice is missing.
    pub fn from_wire(wire: wire::ActRequest) -> Result<Self, Refusal> {
        let Some(wire::act_request::Content::Start(start)) = wire.content else {
            return Err(Refusal::new(Reason::MissingField, "start", "must come first"));
        };
        Ok(match required(start.choice, "start.choice")? {
            wire::act_start::Choice::Mean(_) => Self::Mean,
            wire::act_start::Choice::Sampled(sampled) => Self::Sampled { seed: sampled.seed },
        })
    }
}

impl ActStep {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::ActRequest {
        let observation = |(agent, observation): &(usize, Vec<f32>)| wire::AgentObservation {
            agent: *agent as u32,
            observation: Some(tensor::floats(&[observation.len()], observation)),
        };
        let observations = self.observations.iter().map(observation).collect();
        let step = wire::ActStep { reset: self.reset, observations };
        wire::ActRequest { content: Some(wire::act_request::Content::Step(step)) }
    }
}

impl Acted {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::ActResponse {
        let action = |(agent, action): &(usize, Vec<f32>)| wire::AgentAction {
            agent: *agent as u32,
            action: Some(tensor::floats(&[action.len()], action)),
        };
        let actions = self.actions.iter().map(action).collect();
        wire::ActResponse { weights: Some(self.weights.to_wire()), actions }
    }
}
