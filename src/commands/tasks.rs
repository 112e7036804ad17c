//! `s2mia tasks`: what can be trained.

use std::path::Path;

use anyhow::Context as _;
use serde_json::json;
use sim::{Description, EnvironmentBatch, Outcome};

use crate::cli::TasksArguments;
use crate::config::{Request, layers};
use crate::film::{self, Cast};
use crate::output;
use crate::run_config::RunConfig;

/// Joints that are nearer to one another hide their numbers, metres.
const APART: f32 = 0.08;
/// Steps in which legs are driven apart.
const MOST_STEPS: usize = 30;

/// A table, or a JSON array with every name.
pub(super) fn run(arguments: &TasksArguments) -> anyhow::Result<()> {
    let mut worlds: Vec<Box<dyn EnvironmentBatch>> =
        sim::task_names().iter().map(|name| world(name)).collect::<anyhow::Result<_>>()?;
    if let Some(folder) = &arguments.picture {
        return worlds.iter_mut().try_for_each(|world| draw(&mut **world, folder));
    }
    let tasks: Vec<&Description> = worlds.iter().map(|world| world.description()).collect();
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
    let request = Request { settings: vec![task.to_owned()], ..Request::default() };
    let config = RunConfig::build(layers::resolve(&request)?)?;
    sim::environments(&config.task, 1).with_context(|| format!("cannot build {task}"))
}

/// One picture, and whose each number is; nothing of a game.
fn draw(world: &mut dyn EnvironmentBatch, folder: &Path) -> anyhow::Result<()> {
    let shapes = sim::shapes(&world.description().task).context("cannot build the robot")?;
    if shapes.is_empty() {
        return Ok(());
    }
    let joints = spread(world)?;
    let (task, pose) = (world.description(), world.pose(0));
    let cast = Cast::new(task, shapes, &pose);
    let path = folder.join(format!("{}.png", task.task));
    output::file(&path, &film::portrait(&cast, &joints, &pose)?)?;
    let names = task.agents.iter().flat_map(|agent| &agent.joints);
    let numbers: Vec<String> =
        (1..).zip(names).map(|(number, name)| format!("{number} {name}")).collect();
    output::line(format!("{}: {}", path.display(), numbers.join(", ")));
    Ok(())
}

/// Where all joints are, as soon as no more than one stands where another does: legs one behind the other are driven
/// apart, their hips stay in one place.
fn spread(world: &mut dyn EnvironmentBatch) -> anyhow::Result<Vec<[f32; 3]>> {
    let anchors = sim::hinges(&world.description().task).context("cannot build the robot")?;
    let mut joints = joints(world, &anchors);
    for _ in 0..MOST_STEPS {
        let hidden: Vec<bool> =
            (0..joints.len()).map(|index| hidden(&joints[index], &joints[..index])).collect();
        if hidden.iter().filter(|hidden| **hidden).count() <= 1 {
            break;
        }
        // Of two joints in one place the first turns one way, the second the other.
        let actions: Vec<f32> =
            hidden.iter().map(|hidden| if *hidden { -1.0 } else { 1.0 }).collect();
        world.step(&actions, &mut [Outcome::default()]).context("the robot cannot be moved")?;
        joints = self::joints(world, &anchors);
    }
    Ok(joints)
}

/// Whether a joint is where one of the others is.
fn hidden(joint: &[f32; 3], others: &[[f32; 3]]) -> bool {
    let near = |other: &[f32; 3]| {
        let squares = joint.iter().zip(other).map(|(a, b)| (a - b) * (a - b));
        squares.sum::<f32>() < APART * APART
    };
    others.iter().any(near)
}

/// Where the joints are that the agents drive, in the order of their actions; `anchors` say where on its link each is.
fn joints(world: &dyn EnvironmentBatch, anchors: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let (task, pose) = (world.description(), world.pose(0));
    let links = &pose.links[pose.links.len() - anchors.len()..];
    let place = |name: &String| {
        let index = pose.joints.iter().position(|joint| joint.name == *name)?;
        Some(links[index].in_world(anchors[index]))
    };
    task.agents.iter().flat_map(|agent| &agent.joints).filter_map(place).collect()
}

fn as_table(task: &Description) -> String {
    let mut text = format!(
        "{}: {} agents, state {}, {} steps of {} s\n",
        task.task,
        task.agents.len(),
        task.state.len(),
        task.episode_steps,
        task.dt_secs
    );
    for agent in &task.agents {
        let (name, joints) = (&agent.name, agent.joints.join(" "));
        let observation = agent.observation.len();
        let action = match agent.action.choices {
            None => format!("action {}: {joints}", agent.action.size),
            Some(choices) => format!("one choice among {choices}"),
        };
        text += &format!("  {name:<8} observation {observation:>3}, {action}\n");
    }
    text
}

fn as_json(task: &Description) -> serde_json::Value {
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
