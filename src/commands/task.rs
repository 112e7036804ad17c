//! `s2mia tasks` and `s2mia task`: lists the tasks that can be trained, checks a task file, or writes an example of one.

mod new;
mod trial;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use proto::EnvironmentSpec;
use serde_json::json;
use sim::{Actuator, EnvironmentBatch, Robot, Torque};

use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::figures::chart;
use crate::process::target::{ForceArguments, Target};
use crate::process::{output, shell};

use trial::Trial;

/// Episodes of random actions, and the time after which no further step is played, unless a number of episodes is given.
const EPISODES: u32 = 20;
const LONGEST: Duration = Duration::from_secs(30);

/// `s2mia tasks`
#[derive(Args, Debug)]
pub(crate) struct TasksArguments {
    /// Print one JSON array.
    #[arg(long)]
    pub(crate) json: bool,
}

/// A table, or a JSON array with every name.
pub(super) fn list(arguments: &TasksArguments) -> anyhow::Result<()> {
    let worlds: Vec<Box<dyn EnvironmentBatch>> =
        sim::task_names().iter().map(|name| world(name)).collect::<anyhow::Result<_>>()?;
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

/// Agents and sizes of a task.
pub(super) fn as_table(task: &EnvironmentSpec) -> String {
    let mut text = format!(
        "{}: {}, state {}, {} steps of {} s\n",
        task.task,
        chart::count_of(task.agents.len() as u64, "agent"),
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

/// `s2mia task`
#[derive(Debug, Subcommand)]
pub(crate) enum TaskCommand {
    /// Check a task file: print masses, joints and agents, and play episodes of random actions.
    Check(TaskCheckArguments),
    /// Write a task file with its model into a folder: an example, or a copy of a robot of the program to change.
    New(new::TaskNewArguments),
}

/// `s2mia task check`
#[derive(Args, Debug)]
pub(crate) struct TaskCheckArguments {
    /// Task file, or FILE:PARTITION if it has several partitions.
    #[arg(value_name = "FILE", value_parser = shell::expanded_text)]
    pub(crate) task: String,
    /// Number of episodes of random actions; by default 20, or what 30 s allow.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) episodes: Option<u32>,
    /// Draw eight pictures of the first episode into this PNG file.
    #[arg(long, value_name = "FILE")]
    pub(crate) film: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// Runs one of the commands.
pub(super) fn run(command: &TaskCommand) -> anyhow::Result<()> {
    match command {
        TaskCommand::Check(arguments) => check(arguments),
        TaskCommand::New(arguments) => new::new(arguments),
    }
}

fn world(task: &str) -> anyhow::Result<Box<dyn EnvironmentBatch>> {
    Ok(RunConfig::with(&[task])?.environments(1)?)
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

/// Prints the robot, its agents and what random actions do.
fn check(arguments: &TaskCheckArguments) -> anyhow::Result<()> {
    let film = arguments.film.as_ref();
    let film = film.map(|path| Target::named("--film", path, "png", arguments.force.existing()));
    let film = film.transpose()?;
    let config = RunConfig::with(&[&format!("task={}", arguments.task)])?;
    let mut world = config.environments(1)?;
    let Some(robot) = world.robot() else {
        let why = format!("{} is a game: it has no robot to check", arguments.task);
        return Err(Usage::new(why).into());
    };
    output::line(as_table(world.description()).trim_end());
    output::line(links(robot));
    output::line(joints(robot));
    for line in world.drawn() {
        output::line(format!("drawn {line}"));
    }
    for what in robot.left_out() {
        output::line(format!("left out: {what}"));
    }
    for warning in world.warnings() {
        output::line(format!("warning: {warning}"));
    }
    let mut trial = Trial::default();
    let started = Instant::now();
    let is_late = || arguments.episodes.is_none() && started.elapsed() > LONGEST;
    trial.play_all(&mut *world, arguments.episodes.unwrap_or(EPISODES), &is_late)?;
    if let Some(film) = film {
        film.write(&trial.film(&*world)?)?;
        output::line(film.path().display());
    }
    if trial.is_cut {
        let secs = LONGEST.as_secs();
        output::line(format!(
            "stopped after {secs} s of random actions: give `--episodes` to play more"
        ));
    }
    output::line(trial.summary());
    for warning in trial.constant_terms(&world.description().reward_terms) {
        output::line(format!("warning: {warning}"));
    }
    let why = "the simulation is unstable, moves faster than 1,000 m/s or rad/s, or has more than 2,000 contacts or 100,000 close \
        pairs of shapes at a time: shorten the model's timestep, lower the motors' `gear` or `ctrlrange`, or let fewer shapes touch";
    anyhow::ensure!(trial.faults == 0, why);
    Ok(())
}

/// Mass and principal inertias of each link, and the sum of the masses.
fn links(robot: &Robot) -> String {
    let mut text = String::new();
    let mut total = 0.0;
    for (name, mass, [a, b, c]) in robot.masses() {
        total += f64::from(mass);
        text +=
            &format!("link  {name:<16} {mass:>9.4} kg, inertia {a:.3e} {b:.3e} {c:.3e} kg m^2\n");
    }
    text + &format!("total {:<16} {total:>9.4} kg", "")
}

/// Limits, control range and largest torque of each joint.
fn joints(robot: &Robot) -> String {
    let line = |((name, range), unit): ((&str, Option<[f32; 2]>), &str)| {
        let range = match range {
            Some([low, high]) => format!("{low} to {high} {unit}"),
            None => "no limits".to_owned(),
        };
        format!("joint {name:<16} {range}, {}", motors_of(robot, name))
    };
    let names = robot.hinges().map(|(name, _)| name);
    let joints = names.zip(robot.limits_in_qpos()).zip(robot.hinge_units()).map(line);
    let balls = robot.balls().map(|(name, largest)| {
        let range = largest.map_or("no limits".to_owned(), |most| format!("up to {most} rad"));
        format!("ball  {name:<16} {range}, {}", motors_of(robot, name))
    });
    let is_other = |actuator: &Actuator<'_>| {
        let joints = robot.hinges().map(|(name, _)| name);
        joints.chain(robot.balls().map(|(name, _)| name)).all(|name| name != actuator.joint)
    };
    let others = robot.actuators().filter(is_other).map(|actuator| {
        let name = actuator.joint;
        match actuator.pushed {
            Some(link) => format!("site  {name:<16} of {link}, {}", motor(&actuator)),
            None => {
                let moved = actuator.moved.join(", ");
                format!("tendon {name:<15} moves {moved}, {}", motor(&actuator))
            }
        }
    });
    joints.chain(balls).chain(others).collect::<Vec<_>>().join("\n")
}

/// The motors of a joint.
fn motors_of(robot: &Robot, joint: &str) -> String {
    let of_joint = robot.actuators().filter(|actuator| actuator.joint == joint);
    let motors: Vec<String> = of_joint.map(|actuator| motor(&actuator)).collect();
    if motors.is_empty() { "no motor".to_owned() } else { motors.join("; ") }
}

/// Kind, largest torque and control range of an actuator, and its name if that is not its joint's.
fn motor(actuator: &Actuator<'_>) -> String {
    let newtons = actuator.unit;
    let kind = match actuator.torque {
        Torque::Motor(largest) => format!("motor up to {largest} {newtons}"),
        Torque::Servo(Some(largest)) => format!("servo, at most {largest} {newtons}"),
        Torque::Servo(None) => "servo".to_owned(),
    };
    // Without the sign of a negative 0.
    let [low, high] = actuator.control.map(|end| end + 0.0);
    let name = if actuator.name == actuator.joint {
        String::new()
    } else {
        format!(" ({})", actuator.name)
    };
    format!("{kind}, control {low} to {high}{name}")
}
