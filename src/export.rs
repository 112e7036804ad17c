//! Trained policies for other programs: ONNX for each agent, the weights, and an episode for comparison.

mod episode;
mod graph;
mod onnx;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use policy::ActorPolicy;
use proto::{AgentSpec, EnvironmentSpec};
use serde_json::json;
use sim::{EnvironmentBatch, Robot};

use crate::process::output;
use crate::process::target::{self, Existing};
use crate::progress::WorkProgress;
use crate::run::checkpointed::{self, Trained};
use crate::run::run_path;

/// Writes `agent_I.onnx` for every agent, `policy.safetensors` and `episode.safetensors` into `folder`. Returns the
/// name and the contents of each file. Files of an earlier export are refused, or removed if they are to be replaced.
pub(crate) fn export(
    (folder, existing): (&Path, Existing),
    trained: &Trained,
    world: &mut dyn EnvironmentBatch,
) -> anyhow::Result<Vec<(String, String)>> {
    let earlier = run_path::files(folder, is_exported)?;
    target::demand_free("--onnx", earlier.clone(), existing)?;
    let (snapshot, task) = (&trained.policy, world.description());
    let common = common(trained, task);
    let mut files = Vec::new();
    for (index, (agent, described)) in snapshot.agents.iter().zip(&task.agents).enumerate() {
        let name = format!("agent_{index}.onnx");
        let about: BTreeMap<_, _> =
            common.clone().into_iter().chain(about_agent(described, world.robot())).collect();
        output::file(&folder.join(&name), &graph::model(agent, &about).to_bytes())?;
        files.push((name, sizes(agent)));
    }
    output::file(&folder.join("policy.safetensors"), &snapshot.to_bytes()?)?;
    files.push(("policy.safetensors".to_owned(), "all agents' weights".to_owned()));
    let chosen = trained.episode(0);
    let episode = episode::play(world, snapshot, chosen.key(), &mut WorkProgress::new())?;
    output::file(&folder.join("episode.safetensors"), &episode.to_bytes()?)?;
    let (value, steps) = (episode.extrinsic_return, episode.steps);
    let told = format!(
        "{chosen}: return {value:.2}, {steps} steps; each observation, hidden state, action"
    );
    files.push(("episode.safetensors".to_owned(), told));
    let is_new = |path: &PathBuf| files.iter().any(|(name, _)| path.ends_with(name));
    for path in earlier.into_iter().filter(|path| !is_new(path)) {
        std::fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
    }
    Ok(files)
}

/// Whether an export writes files of this name.
fn is_exported(name: &str) -> bool {
    let number = name.strip_prefix("agent_").and_then(|rest| rest.strip_suffix(".onnx"));
    let of_agent = number.is_some_and(|number| number.parse::<u32>().is_ok());
    of_agent || ["policy.safetensors", "episode.safetensors"].contains(&name)
}

/// Metadata of all agents' models: the run, the duration of a step, and who scales observations.
fn common(trained: &Trained, task: &EnvironmentSpec) -> BTreeMap<String, String> {
    let mut about = checkpointed::metadata(trained, &task.task);
    let scaling = trained.config.resolved.text("observation.norm");
    about.insert("observation_scaling".to_owned(), scaling.to_owned());
    about.insert("dt_secs".to_owned(), task.dt_secs.to_string());
    about
}

/// Metadata of one agent's model: the meaning of each input and output, and the limits of the action and, for a simulated
/// robot, of the controls to which it is mapped.
fn about_agent(agent: &AgentSpec, robot: Option<&Robot>) -> BTreeMap<String, String> {
    let features: Vec<&String> = agent.observation.iter().map(|feature| &feature.name).collect();
    let limits = match agent.action.choices {
        Some(choices) => vec![("action_choices", choices.to_string())],
        None => vec![
            ("action_low", agent.action.low.to_string()),
            ("action_high", agent.action.high.to_string()),
        ],
    };
    let controls = robot.map(|robot| {
        let ranges = agent.joints.iter().filter_map(|joint| robot.control_range(joint));
        let ranges: Vec<_> = ranges.collect();
        ("control_ranges", serde_json::to_string(&ranges).expect("ranges of a model are finite"))
    });
    let words = [
        ("action_unit", agent.action.unit().to_owned()),
        ("agent", agent.name.clone()),
        ("observation_features", json!(features).to_string()),
        ("action_joints", json!(agent.joints).to_string()),
    ];
    let words = words.into_iter().chain(limits).chain(controls);
    words.map(|(name, value)| (name.to_owned(), value)).collect()
}

fn sizes(agent: &ActorPolicy) -> String {
    let (observation, hidden) = (agent.observation_size(), agent.hidden_size());
    let action = agent.action_size();
    format!("observation {observation}, hidden {hidden} -> action {action}, next_hidden {hidden}")
}
