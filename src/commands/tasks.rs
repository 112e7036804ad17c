//! `s2mia tasks`: the tasks that can be trained.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use proto::EnvironmentSpec;
use serde_json::json;
use sim::EnvironmentBatch;

use crate::config::run_config::RunConfig;
use crate::film::{self, RobotShapes};
use crate::process::target::ForceArguments;
use crate::process::{output, target};

/// `s2mia tasks`
#[derive(Args, Debug)]
pub(crate) struct TasksArguments {
    /// Print one JSON array.
    #[arg(long)]
    pub(crate) json: bool,
    /// Draw every robot's partition into DIR/TASK.png, with links in the agents' colours and numbered joints.
    #[arg(long, value_name = "DIR", conflicts_with = "json")]
    pub(crate) picture: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// A table, or a JSON array with every name.
pub(super) fn run(arguments: &TasksArguments) -> anyhow::Result<()> {
    let mut worlds: Vec<Box<dyn EnvironmentBatch>> =
        sim::task_names().iter().map(|name| world(name)).collect::<anyhow::Result<_>>()?;
    if let Some(folder) = &arguments.picture {
        target::option_folder("--picture", folder)?;
        let robots = worlds.iter().filter(|world| world.robot().is_some());
        let pictures = robots.map(|world| picture(folder, world.description()));
        target::demand_free("--picture", pictures, arguments.force.existing())?;
        return worlds.iter_mut().try_for_each(|world| draw(&mut **world, folder));
    }
    let tasks: Vec<&EnvironmentSpec> = worlds.iter().map(|world| world.description()).collect();
    if arguments.json {
        output::line(serde_json::Value::from(
            tasks.iter().map(|task| as_json(task)).collect::<Vec<_>>(),
        ));
        return Ok(());
    }
    for task in &tasks {
        output::line(as_table(task).trim_end());
    }
    Ok(())
}

fn world(task: &str) -> anyhow::Result<Box<dyn EnvironmentBatch>> {
    let config = RunConfig::with(&[task])?;
    sim::environments(&config.task, 1).with_context(|| format!("cannot build {task}"))
}

/// The file of a task's picture.
fn picture(folder: &Path, task: &EnvironmentSpec) -> PathBuf {
    folder.join(format!("{}.png", task.task))
}

/// Draws one picture and prints the names of its numbered joints; a game has no picture.
fn draw(world: &mut dyn EnvironmentBatch, folder: &Path) -> anyhow::Result<()> {
    let Some(robot) = RobotShapes::of(world) else { return Ok(()) };
    let joints = film::distinct_joints(world)?;
    let task = world.description();
    let pose = world.pose(0);
    let path = picture(folder, task);
    target::file(&path, &film::portrait(&robot, &joints, &pose)?)?;
    let names = task.agents.iter().flat_map(|agent| &agent.joints);
    let numbers: Vec<String> =
        (1..).zip(names).map(|(number, name)| format!("{number} {name}")).collect();
    output::line(format!("{}: {}", path.display(), numbers.join(", ")));
    Ok(())
}

/// Agents and sizes of a task.
pub(super) fn as_table(task: &EnvironmentSpec) -> String {
    let mut text = format!(
        "{}: {} agents, state {}, {} steps of {} s\n",
        task.task,
        task.agents.len(),
        task.state.len(),
        task.episode_steps,
        task.dt_secs
    );
    for agent in &task.agents {
        let name = &agent.name;
        let joints = agent.joints.join(" ");
        let observation = agent.observation.len();
        let action = match agent.action.choices {
            None => format!("action {}: {joints}", agent.action.size),
            Some(choices) => format!("one choice among {choices}"),
        };
        text += &format!("  {name:<8} observation {observation:>3}, {action}\n");
    }
    text
}

fn as_json(task: &EnvironmentSpec) -> serde_json::Value {
    let agents: Vec<serde_json::Value> = task
        .agents
        .iter()
        .map(|agent| {
            json!({
                "name": agent.name,
                "joints": agent.joints,
                "observation": agent.observation.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(),
                "action": {
                    "size": agent.action.size,
                    "low": agent.action.low,
                    "high": agent.action.high,
                    "choices": agent.action.choices,
                },
            })
        })
        .collect();
    json!({
        "task": task.task,
        "dt_secs": task.dt_secs,
        "episode_steps": task.episode_steps,
        "state": task.state.iter().map(|feature| feature.name.as_str()).collect::<Vec<_>>(),
        "agents": agents,
    })
}
