//! Requests to trained policies, their validation, and the answers.

use std::collections::BTreeSet;

use crate::read::{bad_value, required};
use crate::tensor::{self, read_floats};
use crate::{Reason, Refusal, WeightsName, wire};

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
    /// Reads a message after the first, for agents with the given numbers of observation features.
    ///
    /// # Errors
    /// If it is another message, there is no observation, an agent is unknown or repeated, or an observation has a wrong
    /// type or length or is not finite.
    pub fn from_wire(
        wire: &wire::ActRequest,
        observation_sizes: &[usize],
    ) -> Result<Self, Refusal> {
        let step = match &wire.content {
            Some(wire::act_request::Content::Step(step)) => step,
            Some(wire::act_request::Content::Start(_)) => {
                return Err(bad_value("start", "must be the first message"));
            }
            None => return Err(Refusal::new(Reason::MissingField, "content", "must be set")),
        };
        let list = "step.observations";
        if step.observations.is_empty() {
            return Err(Refusal::new(Reason::MissingField, list, "must not be empty"));
        }
        let mut named = BTreeSet::new();
        let mut observations = Vec::new();
        for (i, row) in step.observations.iter().enumerate() {
            let agent = row.agent as usize;
            let agents = observation_sizes.len();
            let agent_field = format!("{list}[{i}].agent");
            if agent >= agents {
                return Err(bad_value(&agent_field, format!("{agent}, the team has {agents}")));
            }
            if !named.insert(agent) {
                return Err(bad_value(&agent_field, format!("{agent} is repeated")));
            }
            let field = format!("{list}[{i}].observation");
            let size = [observation_sizes[agent]];
            observations.push((agent, read_floats(row.observation.as_ref(), &size, &field)?));
        }
        Ok(Self { reset: step.reset, observations })
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
