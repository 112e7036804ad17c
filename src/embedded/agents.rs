//! Descriptions of agents as JSON, as Python's `AgentSpec` has them.

use std::collections::BTreeSet;

use policy::ActorPolicy;
use serde_json::{Value, json};
use sim::EnvironmentBatch;

use crate::run::AGENTS;

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

/// The agents of an external environment, of which only that program knows features and limits. The run's `manifest` has
/// their names, which count if they differ.
pub(super) fn of_policies(policies: &[ActorPolicy], manifest: Option<&Value>) -> Vec<Value> {
    // Two agents may have one name in another program.
    let are_distinct = |names: &&Vec<Value>| {
        names.iter().filter_map(Value::as_str).collect::<BTreeSet<_>>().len() == names.len()
    };
    let names = manifest.and_then(|manifest| manifest[AGENTS].as_array()).filter(are_distinct);
    let agents = policies.iter().enumerate().map(|(index, policy)| {
        let name = names.and_then(|names| names.get(index)?.as_str());
        json!({
            "name": name.map_or_else(|| format!("agent_{index}"), str::to_owned),
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
