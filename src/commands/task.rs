//! `s2mia tasks` and `s2mia task`: lists the tasks that can be trained, checks a task file, or writes an example of one.

mod new;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::{Args, Subcommand};
use policy::randomness::uniform;
use policy::{Draw, DrawKey, Purpose, RunSeed};
use proto::EnvironmentSpec;
use serde_json::json;
use sim::{Actuator, EnvironmentBatch, Outcome, Pose, Robot, Torque};

use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::film::{self, RobotShapes, TimedPose, ViewDirection};
use crate::process::target::{ForceArguments, Target};
use crate::process::{output, shell};

/// Seed of the random actions.
const SEED: RunSeed = RunSeed(0);

/// Episodes of random actions, and the time after which no further step is played, unless a number of episodes is given.
const EPISODES: u32 = 20;
const LONGEST: Duration = Duration::from_secs(30);

/// Pictures of a film.
const FRAMES: usize = 8;

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
    let why = "the simulation is unstable, or has more than 2,000 contacts or 100,000 close pairs of shapes at a time: \
        shorten the model's timestep, or let fewer shapes touch";
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
    let line = |((name, range), [unit, newtons]): ((&str, Option<[f32; 2]>), [&str; 2])| {
        let range = match range {
            Some([low, high]) => format!("{low} to {high} {unit}"),
            None => "no limits".to_owned(),
        };
        format!("joint {name:<16} {range}, {}", motors_of(robot, name, newtons))
    };
    let names = robot.hinges().map(|(name, _)| name);
    let joints = names.zip(robot.limits_in_qpos()).zip(robot.hinge_units()).map(line);
    let balls = robot.balls().map(|(name, largest)| {
        let range = largest.map_or("no limits".to_owned(), |most| format!("up to {most} rad"));
        format!("ball  {name:<16} {range}, {}", motors_of(robot, name, "N m"))
    });
    let is_tendon = |actuator: &Actuator<'_>| {
        let joints = robot.hinges().map(|(name, _)| name);
        joints.chain(robot.balls().map(|(name, _)| name)).all(|name| name != actuator.joint)
    };
    let tendons = robot.actuators().filter(is_tendon).map(|actuator| {
        let (name, moved) = (actuator.joint, actuator.moved.join(", "));
        format!("tendon {name:<15} moves {moved}, {}", motor(&actuator, "N"))
    });
    joints.chain(balls).chain(tendons).collect::<Vec<_>>().join("\n")
}

/// The motors of a joint.
fn motors_of(robot: &Robot, joint: &str, newtons: &str) -> String {
    let of_joint = robot.actuators().filter(|actuator| actuator.joint == joint);
    let motors: Vec<String> = of_joint.map(|actuator| motor(&actuator, newtons)).collect();
    if motors.is_empty() { "no motor".to_owned() } else { motors.join("; ") }
}

/// Kind, largest torque and control range of an actuator, and its name if that is not its joint's.
fn motor(actuator: &Actuator<'_>, newtons: &str) -> String {
    let kind = match actuator.torque {
        Torque::Motor(largest) => format!("motor up to {largest} {newtons}"),
        Torque::Servo(Some(largest)) => format!("servo, at most {largest} {newtons}"),
        Torque::Servo(None) => "servo".to_owned(),
    };
    let [low, high] = actuator.control;
    let name = match actuator.name == actuator.joint {
        true => String::new(),
        false => format!(" ({})", actuator.name),
    };
    format!("{kind}, control {low} to {high}{name}")
}

/// What happens under random actions.
#[derive(Default)]
struct Trial {
    /// Episodes that began.
    episodes: u32,
    /// Whether the last episode has no end, because the time was over.
    is_cut: bool,
    steps: u64,
    total: f64,
    terminated: u32,
    faults: u32,
    /// Largest velocity, m/s or rad/s, and its name.
    fastest: (f32, String),
    /// The shapes of the first episode; `None` for a game.
    robot: Option<RobotShapes>,
    /// Poses of the first episode.
    poses: Vec<Pose>,
}

impl Trial {
    /// Plays up to `count` episodes, until `is_late`.
    fn play_all(
        &mut self,
        world: &mut dyn EnvironmentBatch,
        count: u32,
        is_late: &dyn Fn() -> bool,
    ) -> anyhow::Result<()> {
        for episode in 0..count {
            self.play(world, episode, is_late)?;
            if self.is_cut {
                break;
            }
        }
        Ok(())
    }

    /// Plays an episode with uniformly distributed actions, at least a step of it, until `is_late`.
    fn play(
        &mut self,
        world: &mut dyn EnvironmentBatch,
        episode: u32,
        is_late: &dyn Fn() -> bool,
    ) -> anyhow::Result<()> {
        self.episodes += 1;
        let limit = world.description().episode_steps;
        let start = Draw::of(Purpose::EvaluationReset).iteration(episode.into());
        world.reset(0, 0, limit, DrawKey::of(SEED, start).0)?;
        if episode == 0 {
            self.robot = RobotShapes::of(world);
        }
        let mut outcome = [Outcome::default()];
        for step in 0.. {
            if episode == 0 {
                self.poses.push(world.pose(0));
            }
            let action = random_action(world, episode, step);
            world.step(&action, &mut outcome)?;
            self.steps += 1;
            self.total += f64::from(outcome[0].reward);
            self.note_speed(world);
            if outcome[0].is_end() {
                break;
            }
            if is_late() {
                self.is_cut = true;
                break;
            }
        }
        self.terminated += u32::from(outcome[0].terminated);
        self.faults += u32::from(outcome[0].fault);
        Ok(())
    }

    fn note_speed(&mut self, world: &dyn EnvironmentBatch) {
        let Some(world) = world.world(0) else { return };
        let mut velocities = vec![0.0; world.robot().velocity_names().len()];
        world.velocities(&mut velocities);
        for (velocity, name) in velocities.into_iter().zip(world.robot().velocity_names()) {
            if velocity.abs() > self.fastest.0 {
                self.fastest = (velocity.abs(), name.clone());
            }
        }
    }

    fn summary(&self) -> String {
        let episodes = self.episodes;
        let mean = |sum: f64| sum / f64::from(episodes);
        format!(
            "{episodes} episodes of random actions: mean length {:.1} steps, mean return {:.1}, {} ended by the task's \
             rules, {} by a physics fault; largest speed {:.1} ({})",
            mean(self.steps as f64),
            mean(self.total),
            self.terminated,
            self.faults,
            self.fastest.0,
            self.fastest.1,
        )
    }

    /// Pictures of the first episode at equal distances.
    fn film(&self, world: &dyn EnvironmentBatch) -> anyhow::Result<Vec<u8>> {
        let robot = self.robot.as_ref().context("only robots can be drawn")?;
        let dt_secs = world.description().dt_secs;
        let count = FRAMES.min(self.poses.len());
        let frame = |picture: usize| {
            let step = picture * (self.poses.len() - 1) / count.saturating_sub(1).max(1);
            TimedPose { time_secs: step as f64 * dt_secs, pose: &self.poses[step] }
        };
        film::strip(robot, &(0..count).map(frame).collect::<Vec<_>>(), ViewDirection::Side)
    }
}

/// Actions of all agents, uniform in their ranges, `[A]`.
fn random_action(world: &dyn EnvironmentBatch, episode: u32, step: u32) -> Vec<f32> {
    let agents = (0..).zip(&world.description().agents);
    let draw = |(number, agent): (u32, &proto::AgentSpec)| {
        let key = Draw::of_action(0, episode, step, number);
        let mut rng = DrawKey::of(SEED, key).generator();
        let range = agent.action.low..agent.action.high;
        let width = range.end - range.start;
        (0..agent.action.size).map(|_| range.start + width * uniform(&mut rng)).collect::<Vec<_>>()
    };
    agents.flat_map(draw).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episodes_stop_in_a_step_after_which_the_time_is_over() {
        let mut world = world("walker2d-2x3").unwrap();
        let mut trial = Trial::default();
        trial.play_all(&mut *world, 20, &|| true).unwrap();
        assert_eq!((trial.episodes, trial.steps, trial.is_cut), (1, 1, true));
        let mut trial = Trial::default();
        trial.play_all(&mut *world, 2, &|| false).unwrap();
        assert_eq!((trial.episodes, trial.is_cut), (2, false));
    }
}
