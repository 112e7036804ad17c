//! `s2mia tasks`: what can be trained.

use anyhow::Context as _;
use serde_json::json;

use crate::cli::TasksArguments;
use crate::config::{Request, layers};
use crate::output;
use crate::run_config::RunConfig;

/// A table, or a JSON array with every name.
pub(super) fn run(arguments: &TasksArguments) -> anyhow::Result<()> {
    let tasks: Vec<sim::Description> =
        sim::task_names().iter().map(|name| describe(name)).collect::<anyhow::Result<_>>()?;
    if arguments.json {
        output::line(serde_json::Value::from(tasks.iter().map(as_json).collect::<Vec<_>>()));
        return Ok(());
    }
    for task in &tasks {
        output::line(as_table(task).trim_end());
    }
    Ok(())
}

fn describe(task: &str) -> anyhow::Result<sim::Description> {
    let request = Request { settings: vec![task.to_owned()], ..Request::default() };
    let config = RunConfig::build(layers::resolve(&request)?)?;
    let world =
        sim::Environments::new(&config.task, 1).with_context(|| format!("cannot build {task}"))?;
    Ok(world.description().clone())
}

fn as_table(task: &sim::Description) -> String {
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

fn as_json(task: &sim::Description) -> serde_json::Value {
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
