//! `s2mia export`: a trained policy for other programs: ONNX for each agent, the weights, and an episode for comparison.

mod onnx;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use learner::store::checkpoint;
use policy::arrays::{Array, ArrayError, NamedArrays, to_safetensors};
use policy::{ActorPolicy, DrawKey, PolicySnapshot};
use proto::{ActionChoice, AgentSpec, EnvironmentSpec};
use rollout::StepEvent;
use serde_json::json;
use sim::{EnvironmentBatch, SimError};

use crate::errors::Usage;
use crate::figures::chart;
use crate::process::target::{Existing, ForceArguments};
use crate::process::{output, target};
use crate::progress::WorkProgress;
use crate::run::chosen::{ChosenArguments, ProgramArguments};
use crate::run::stored::Trained;
use crate::run::{run_path, stored};

/// `s2mia export`
#[derive(Args, Debug)]
pub(crate) struct ExportArguments {
    /// Policies.
    #[command(flatten)]
    pub(crate) of: ChosenArguments,
    /// Environment.
    #[command(flatten)]
    pub(crate) program: ProgramArguments,
    /// Folder for agent_0.onnx, agent_1.onnx, ..., policy.safetensors and episode.safetensors.
    #[arg(long, value_name = "DIR")]
    pub(crate) onnx: PathBuf,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// Writes the files and prints what each contains.
pub(super) fn run(arguments: &ExportArguments) -> anyhow::Result<()> {
    let run = arguments.of.path()?;
    let trained = arguments.program.trained(&run)?;
    let mut hosted = trained.environment()?;
    demand_no_checkpoint(&arguments.onnx)?;
    target::option_folder("--onnx", &arguments.onnx)?;
    let existing = arguments.force.existing();
    let files = export((&arguments.onnx, existing), &trained, hosted.environment.as_mut())?;
    let steps = chart::thousands(trained.env_steps);
    let iteration = trained.iteration;
    output::line(format!(
        "{}: policies of iteration {iteration}, {steps} env steps",
        run.display()
    ));
    for (name, holds) in files {
        output::line(format!("{}: {holds}", arguments.onnx.join(name).display()));
    }
    Ok(())
}

/// Refuses the folder of a checkpoint, whose own policies an export would replace.
fn demand_no_checkpoint(folder: &Path) -> Result<(), Usage> {
    if !checkpoint::is_checkpoint(folder) {
        return Ok(());
    }
    let why = "is a checkpoint, whose policies an export would replace; name another folder";
    Err(Usage::new(format!("--onnx {}: {why}", folder.display())))
}

/// Writes `agent_I.onnx` for every agent, `policy.safetensors` and `episode.safetensors` into `folder`. Returns the
/// name and the contents of each file. Files of an earlier export are refused, or removed if they are to be replaced.
fn export(
    (folder, existing): (&Path, Existing),
    trained: &Trained,
    world: &mut dyn EnvironmentBatch,
) -> anyhow::Result<Vec<(String, String)>> {
    let earlier = run_path::plain_files(folder, is_exported)?;
    target::demand_free("--onnx", earlier.clone(), existing)?;
    let snapshot = &trained.policy;
    let task = world.description();
    let common = common(trained, task);
    let mut files = Vec::new();
    for (index, (agent, described)) in snapshot.agents.iter().zip(&task.agents).enumerate() {
        let name = format!("agent_{index}.onnx");
        let controls = world.robot().map(|_| about_controls(world, index));
        let about = about_agent(described).into_iter().chain(controls.into_iter().flatten());
        let about: BTreeMap<_, _> = common.clone().into_iter().chain(about).collect();
        target::file(&folder.join(&name), &onnx::model(agent, &about).to_bytes())?;
        files.push((name, sizes(agent)));
    }
    target::file(&folder.join("policy.safetensors"), &snapshot.to_bytes()?)?;
    files.push(("policy.safetensors".to_owned(), "all agents' weights".to_owned()));
    let chosen = trained.episode(0);
    let episode = play(world, snapshot, chosen.key(), &WorkProgress::new())?;
    target::file(&folder.join("episode.safetensors"), &episode.to_bytes()?)?;
    let (value, steps) = (episode.extrinsic_return, episode.steps);
    let remembers = snapshot.agents.iter().any(|agent| agent.hidden_size() > 0);
    let hidden = if remembers { "hidden state, " } else { "" };
    let contents =
        format!("{chosen}: return {value:.2}, {steps} steps; each observation, {hidden}action");
    files.push(("episode.safetensors".to_owned(), contents));
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
    let mut about = stored::metadata(trained, &task.task);
    let scaling = trained.config.resolved.text("observation.norm");
    about.insert("observation_scaling".to_owned(), scaling.to_owned());
    about.insert("dt_secs".to_owned(), task.dt_secs.to_string());
    about
}

/// Metadata of one agent's model: the meaning of each input and output, and the limits of the action.
fn about_agent(agent: &AgentSpec) -> BTreeMap<String, String> {
    let features: Vec<&String> = agent.observation.iter().map(|feature| &feature.name).collect();
    let limits = match agent.action.choices {
        Some(choices) => vec![("action_choices", choices.to_string())],
        None => vec![
            ("action_low", agent.action.low.to_string()),
            ("action_high", agent.action.high.to_string()),
        ],
    };
    let words = [
        ("action_unit", agent.action.unit().to_owned()),
        ("agent", agent.name.clone()),
        ("observation_features", json!(features).to_string()),
        ("action_joints", json!(agent.joints).to_string()),
    ];
    let words = words.into_iter().chain(limits);
    words.map(|(name, value)| (name.to_owned(), value)).collect()
}

/// Metadata of the model of an agent of a simulated robot: the controls to which its actions are mapped, and the actuators.
fn about_controls(world: &dyn EnvironmentBatch, agent: usize) -> [(String, String); 2] {
    let ranges = serde_json::to_string(&world.control_ranges(agent));
    let actuators = serde_json::to_string(&world.actuators(agent));
    [("control_ranges", ranges), ("actuators", actuators)]
        .map(|(name, text)| (name.to_owned(), text.expect("numbers of a model are finite")))
}

fn sizes(agent: &ActorPolicy) -> String {
    let (observation, hidden) = (agent.observation_size(), agent.hidden_size());
    let action = agent.action_size();
    match hidden {
        0 => format!("observation {observation} -> action {action}"),
        _ => format!(
            "observation {observation}, hidden {hidden} -> action {action}, next_hidden {hidden}"
        ),
    }
}

/// Observations, hidden states and actions of every agent.
struct ComparedEpisode {
    steps: usize,
    extrinsic_return: f64,
    agents: Vec<Track>,
}

/// One agent's part; row `t` of each is step `t`.
#[derive(Default)]
struct Track {
    observation: Vec<f32>,
    /// Before the step.
    hidden: Vec<f32>,
    action: Vec<f32>,
}

/// Plays an episode with mean actions from the start that the key draws.
fn play(
    world: &mut dyn EnvironmentBatch,
    policy: &PolicySnapshot,
    start: DrawKey,
    progress: &WorkProgress,
) -> Result<ComparedEpisode, SimError> {
    let most = u64::from(world.description().episode_steps);
    let mut agents: Vec<Track> = Vec::new();
    for agent in &policy.agents {
        agents.push(Track { hidden: vec![0.0; agent.hidden_size()], ..Track::default() });
    }
    let episode = rollout::play_episode(world, policy, (start, ActionChoice::Mean), |event| {
        let StepEvent::After(step) = event else { return };
        for (index, track) in agents.iter_mut().enumerate() {
            track.observation.extend(&step.observation[index]);
            track.hidden.extend(&step.hidden[index]);
            track.action.extend(&step.actions[index]);
        }
        let place = || format!("episode for comparison, step {}", step.step);
        progress.reach(step.step.into(), most, place);
    })?;
    // No step uses the hidden state after the last one.
    for (track, agent) in agents.iter_mut().zip(&policy.agents) {
        track.hidden.truncate(episode.steps as usize * agent.hidden_size());
    }
    let extrinsic_return = episode.extrinsic_return;
    Ok(ComparedEpisode { steps: episode.steps as usize, extrinsic_return, agents })
}

impl ComparedEpisode {
    /// A safetensors file: `agent_I.observation` `[T, obs]`, `agent_I.hidden` `[T, H]` of an agent with a recurrent state, and
    /// `agent_I.action` `[T, act]`.
    fn to_bytes(&self) -> Result<Vec<u8>, ArrayError> {
        let mut arrays = NamedArrays::new();
        for (index, track) in self.agents.iter().enumerate() {
            let parts = [
                ("observation", &track.observation),
                ("hidden", &track.hidden),
                ("action", &track.action),
            ];
            for (name, data) in parts.into_iter().filter(|(_, data)| !data.is_empty()) {
                let shape = vec![self.steps, data.len() / self.steps];
                let array = Array::F32 { shape, data: data.clone() };
                arrays.insert(format!("agent_{index}.{name}"), array);
            }
        }
        to_safetensors(&arrays, &BTreeMap::new())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_export_never_replaces_the_policies_of_a_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoint = folder.path().join("checkpoints/iter_00000004");
        std::fs::create_dir_all(&checkpoint).unwrap();
        assert_eq!(demand_no_checkpoint(folder.path()).map_err(|why| why.to_string()), Ok(()));
        for name in ["policy.safetensors", "manifest.json"] {
            std::fs::write(checkpoint.join(name), "").unwrap();
        }
        let refused = demand_no_checkpoint(&checkpoint).unwrap_err().to_string();
        assert!(refused.ends_with("would replace; name another folder"), "{refused}");
    }
}
