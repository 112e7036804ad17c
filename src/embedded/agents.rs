//! Descriptions of agents as JSON, as Python's `AgentSpec` has them.

use policy::ActorPolicy;
use serde_json::{Value, json};
use sim::EnvironmentBatch;

/// The agents of a task, in their order.
pub(super) fn of_task(world: &dyn EnvironmentBatch) -> Vec<Value> {
    let agents = world.description().agents.iter().enumerate();
    let agents = agents.map(|(index, spec)| {
        let features = spec.observation.iter().map(|feature| feature.name.as_str());
        json!({
            "name": spec.name,
            "joints": spec.joints,
            "features": features.collect::<Vec<_>>(),
            "action_size": spec.action.size,
            "choices": spec.action.choices,
            "control_ranges": world.control_ranges(index),
            "actuators": world.actuators(index),
        })
    });
    agents.collect()
}

/// The agents of an external environment, of which only that program knows names and limits.
pub(super) fn of_policies(policies: &[ActorPolicy]) -> Vec<Value> {
    let agents = policies.iter().enumerate().map(|(index, policy)| {
        json!({
            "name": format!("agent_{index}"),
            "joints": [],
            "features": [],
            "action_size": policy.action_size(),
            "choices": policy.head().choices(),
            "control_ranges": [],
            "actuators": [],
        })
    });
    agents.collect()
}
