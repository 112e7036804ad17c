//! Validation of requests to trained policies and of their answers: agents; types, shapes and lengths; values.

use std::collections::BTreeSet;

use crate::read::bad_value;
use crate::tensor::read_floats;
use crate::{ActStep, Acted, Reason, Refusal, WeightsName, wire};

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
        let rows = step.observations.iter();
        let rows = rows.map(|row| (row.agent, row.observation.as_ref()));
        let field = "step.observations";
        let observations = numbers(rows, observation_sizes, field, "observation")?;
        if observations.is_empty() {
            return Err(Refusal::new(Reason::MissingField, field, "must not be empty"));
        }
        Ok(Self { reset: step.reset, observations })
    }
}

impl Acted {
    /// Reads an answer, for agents with the given numbers of action values.
    ///
    /// # Errors
    /// As [`ActStep::from_wire`].
    pub fn from_wire(wire: wire::ActResponse, action_sizes: &[usize]) -> Result<Self, Refusal> {
        let rows = wire.actions.iter().map(|row| (row.agent, row.action.as_ref()));
        let actions = numbers(rows, action_sizes, "actions", "action")?;
        Ok(Self { weights: WeightsName::from_wire(wire.weights, "weights")?, actions })
    }
}

/// Finite values `[size]` for each named agent; an agent must not be repeated.
fn numbers<'a>(
    rows: impl Iterator<Item = (u32, Option<&'a wire::Tensor>)>,
    sizes: &[usize],
    list: &str,
    name: &str,
) -> Result<Vec<(usize, Vec<f32>)>, Refusal> {
    let mut named = BTreeSet::new();
    let mut read = Vec::new();
    for (i, (agent, tensor)) in rows.enumerate() {
        let agent = agent as usize;
        let agents = sizes.len();
        let agent_field = format!("{list}[{i}].agent");
        if agent >= agents {
            return Err(bad_value(&agent_field, format!("{agent}, the team has {agents}")));
        }
        if !named.insert(agent) {
            return Err(bad_value(&agent_field, format!("{agent} is repeated")));
        }
        let field = format!("{list}[{i}].{name}");
        read.push((agent, read_floats(tensor, &[sizes[agent]], &field)?));
    }
    Ok(read)
}
