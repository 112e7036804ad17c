//! Trained policies for other programs: ONNX for each agent, the weights, and an episode for comparison.

mod episode;
mod graph;
mod onnx;

use std::collections::BTreeMap;
use std::path::Path;

use policy::{ActorPolicy, Key, PolicySnapshot};
use sim::EnvironmentBatch;

use crate::process::output;

/// Writes `agent_I.onnx` for every agent, `policy.safetensors` and `episode.safetensors` into `folder`. Returns the
/// name and the contents of each file.
pub(crate) fn export(
    folder: &Path,
    snapshot: &PolicySnapshot,
    world: &mut dyn EnvironmentBatch,
    start: Key,
    about: &BTreeMap<String, String>,
) -> anyhow::Result<Vec<(String, String)>> {
    let mut files = Vec::new();
    for (index, agent) in snapshot.agents.iter().enumerate() {
        let name = format!("agent_{index}.onnx");
        output::file(&folder.join(&name), &graph::model(agent, about).to_bytes())?;
        files.push((name, sizes(agent)));
    }
    output::file(&folder.join("policy.safetensors"), &snapshot.to_bytes()?)?;
    files.push(("policy.safetensors".to_owned(), "all agents' weights".to_owned()));
    let episode = episode::play(world, snapshot, start)?;
    output::file(&folder.join("episode.safetensors"), &episode.to_bytes()?)?;
    let told = format!("one episode, {} steps: observation, hidden state, action", episode.steps);
    files.push(("episode.safetensors".to_owned(), told));
    Ok(files)
}

fn sizes(agent: &ActorPolicy) -> String {
    let (observation, hidden) = (agent.observation_size(), agent.hidden_size());
    let action = agent.action_size();
    format!("observation {observation}, hidden {hidden} -> action {action}, next_hidden {hidden}")
}
