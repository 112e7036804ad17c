//! The check of what is asked of trained policies, and of what they answer: who, then types, shapes and lengths, then
//! values.

use std::collections::BTreeSet;

use crate::read::hold;
use crate::tensor::Floats;
use crate::{ActStep, Acted, Reason, Refusal, WeightsName, wire};

impl ActStep {
    /// Reads a later message of a stream of a team whose agents observe so many numbers each.
    ///
    /// # Errors
    /// Refuses, by field, any other message, no observation at all, agents that there are not or that come twice, and
    /// observations of another type or length or with numbers that are not finite.
    pub fn from_wire(
        wire: &wire::ActRequest,
        observation_sizes: &[usize],
    ) -> Result<Self, Refusal> {
        let step = match &wire.content {
            Some(wire::act_request::Content::Step(step)) => step,
            Some(wire::act_request::Content::Start(_)) => {
                return Err(Refusal::new(
                    Reason::BadValue,
                    "start",
                    "comes once, at the beginning",
                ));
            }
            None => return Err(Refusal::new(Reason::MissingField, "content", "must be set")),
        };
        let rows = step.observations.iter();
        let rows = rows.map(|row| (row.agent, row.observation.as_ref()));
        let field = "step.observations";
        let observations = numbers(rows, observation_sizes, (field, "observation"))?;
        if observations.is_empty() {
            return Err(Refusal::new(Reason::MissingField, field, "at least one"));
        }
        Ok(Self { reset: step.reset, observations })
    }
}

impl Acted {
    /// Reads the answer of a team whose agents' actions have so many numbers each.
    ///
    /// # Errors
    /// Refuses what [`ActStep::from_wire`] refuses of observations.
    pub fn from_wire(wire: wire::ActResponse, action_sizes: &[usize]) -> Result<Self, Refusal> {
        let rows = wire.actions.iter().map(|row| (row.agent, row.action.as_ref()));
        let actions = numbers(rows, action_sizes, ("actions", "action"))?;
        Ok(Self { weights: WeightsName::from_wire(wire.weights, "weights")?, actions })
    }
}

/// `[size]` finite numbers for each agent that is named, none of them twice.
fn numbers<'a>(
    rows: impl Iterator<Item = (u32, Option<&'a wire::Tensor>)>,
    sizes: &[usize],
    (list, name): (&str, &str),
) -> Result<Vec<(usize, Vec<f32>)>, Refusal> {
    let mut named = BTreeSet::new();
    let mut shaped = Vec::new();
    for (i, (agent, tensor)) in rows.enumerate() {
        let (agent, agents) = (agent as usize, sizes.len());
        let new = agent < agents && named.insert(agent);
        let detail = || match agent < agents {
            true => format!("{agent} comes twice"),
            false => format!("{agent}, the team has {agents}"),
        };
        hold(new.then_some(()).ok_or_else(detail), &format!("{list}[{i}].agent"))?;
        let field = format!("{list}[{i}].{name}");
        shaped.push((agent, Floats::check(tensor, &[sizes[agent]], field)?));
    }
    shaped.into_iter().map(|(agent, row)| Ok((agent, row.decode()?))).collect()
}
