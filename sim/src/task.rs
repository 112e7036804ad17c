//! Tasks: a robot, its partition among agents, and the rules for starts, rewards and ends of episodes. Each comes from a
//! task file, which is part of the program or of the settings.

mod actions;
mod body_terms;
mod command;
mod definition;
mod disturbance;
mod healthy;
mod names;
mod reading;
mod relations;
mod rules;
mod start;
mod terms;

use std::collections::BTreeSet;
use std::sync::LazyLock;

use actions::control_ranges;
pub(crate) use definition::{Around, Audience, TaskFile};
use definition::{check_repeats, refused};
pub(crate) use disturbance::DrawnEpisode;
use names::Names;
pub(crate) use rules::Rules;
pub(crate) use terms::Transition;

use crate::config::{TaskConfig, TaskDefinition};
use crate::error::SimError;
use crate::game;
use crate::robot::{MotorPlan, Neighbourhood, Place, PlaceMotion, Robot};

/// A task, without its settings.
pub(crate) struct Task {
    pub(crate) name: String,
    pub(crate) robot: Robot,
    /// Motors of each agent, as indices of the model's actuators.
    pub(crate) agents: Vec<Vec<usize>>,
    /// Steps after which an episode is truncated.
    pub(crate) episode_steps: u32,
    pub(crate) rules: Rules,
    /// Controls for the actions -1 and 1, in the order of the model's actuators.
    pub(crate) control_ranges: Vec<[f32; 2]>,
}

/// Coordinates and velocities of a robot at one time.
#[derive(Clone, Copy)]
pub(crate) struct Motion<'a> {
    /// Relative to the rest pose `[nq]`.
    pub(crate) coordinates: &'a [f32],
    /// Offset from these coordinates to the model's own, `[nq]`.
    pub(crate) reference: &'a [f32],
    /// `[nv]`.
    pub(crate) velocities: &'a [f32],
}

impl Motion<'_> {
    /// A coordinate in the model's own frame, m or rad.
    pub(crate) fn position(&self, index: usize) -> f32 {
        self.coordinates[index] + self.reference[index]
    }

    /// Motion of a body or point.
    pub(crate) fn of(&self, place: &Place) -> PlaceMotion {
        place.motion(self.coordinates, self.velocities)
    }
}

/// Task files and models that are part of the program.
const SHIPPED: [[&str; 2]; 10] = [
    [include_str!("../assets/halfcheetah.toml"), include_str!("../assets/halfcheetah.xml")],
    [include_str!("../assets/walker2d.toml"), include_str!("../assets/walker2d.xml")],
    [include_str!("../assets/ant.toml"), include_str!("../assets/ant.xml")],
    [include_str!("../assets/halfcheetah-pushed.toml"), include_str!("../assets/halfcheetah.xml")],
    [include_str!("../assets/walker2d-pushed.toml"), include_str!("../assets/walker2d.xml")],
    [include_str!("../assets/ant-pushed.toml"), include_str!("../assets/ant.xml")],
    [include_str!("../assets/humanoid.toml"), include_str!("../assets/humanoid.xml")],
    [include_str!("../assets/quadruped.toml"), include_str!("../assets/quadruped.xml")],
    [include_str!("../assets/carry-light.toml"), include_str!("../assets/carry-light.xml")],
    [include_str!("../assets/carry-heavy.toml"), include_str!("../assets/carry-heavy.xml")],
];

static FILES: LazyLock<Vec<(TaskFile, &str)>> = LazyLock::new(|| {
    let parse = |text| TaskFile::parse(text).expect("a test builds every task of the program");
    SHIPPED.iter().map(|[text, mjcf]| (parse(text), *mjcf)).collect()
});

/// Names of the robots' tasks, then of the games.
static NAMES: LazyLock<Vec<String>> = LazyLock::new(|| {
    let robots = FILES.iter().flat_map(|(file, _)| file.task_names());
    robots.chain(game::NAMES.map(str::to_owned)).collect()
});

static NAME_LIST: LazyLock<Vec<&str>> =
    LazyLock::new(|| NAMES.iter().map(String::as_str).collect());

/// Names of all tasks that are part of the program.
pub fn task_names() -> &'static [&'static str] {
    &NAME_LIST
}

/// Builds the task that the settings name or define.
pub(crate) fn find(config: &TaskConfig) -> Result<Task, SimError> {
    let (mut file, model) = own_file(config)?;
    for (term, weight) in config.weights.iter().flatten() {
        *file.weight_mut(term)? = *weight;
    }
    Task::build(&file, model, &config.task)
}

/// The task's file and model.
fn own_file(config: &TaskConfig) -> Result<(TaskFile, &str), SimError> {
    match &config.definition {
        Some(definition) => Ok((TaskFile::parse(&definition.file)?, &definition.model)),
        None => shipped(&config.task).map(|(file, mjcf)| (file.clone(), *mjcf)),
    }
}

impl TaskConfig {
    /// Builds the robot's task and discards it.
    ///
    /// # Errors
    /// If there is no such task, or it has no reward term of a name in `weights`.
    pub fn check(&self) -> Result<(), SimError> {
        find(self).map(|_| ())
    }

    /// Weight of a reward term in the task's file.
    ///
    /// # Errors
    /// If there is no such task, or it has no reward term of this name.
    pub fn weight_in_file(&self, term: &str) -> Result<f32, SimError> {
        own_file(self)?.0.weight_mut(term).copied()
    }
}

/// Finds the file of a task that is part of the program.
fn shipped(name: &str) -> Result<&'static (TaskFile, &'static str), SimError> {
    let found = FILES.iter().find(|(file, _)| file.task_names().any(|task| task == name));
    let known = || NAMES.join(", ");
    found.ok_or_else(|| refused(format!("there is no task `{name}`; known tasks: {}", known())))
}

impl Robot {
    /// Builds the robot of a task that is part of the program.
    ///
    /// # Errors
    /// If no robot has a task with this name.
    pub fn of_task(task: &str) -> Result<Self, SimError> {
        let (file, mjcf) = shipped(task)?;
        Self::build(file.robot_row((*mjcf).to_owned()))
    }
}

impl Task {
    /// Builds a task of a file and checks all names against the robot.
    fn build(file: &TaskFile, mjcf: &str, name: &str) -> Result<Self, SimError> {
        let robot = Robot::build(file.robot_row(mjcf.to_owned()))?;
        let prefix = format!("{}-", file.robot);
        let agents = name.strip_prefix(&prefix).and_then(|partition| file.agents.get(partition));
        let Some(agents) = agents else {
            let known = file.task_names().collect::<Vec<_>>().join(", ");
            return Err(refused(format!("there is no task `{name}` in the file, only {known}")));
        };
        let agents = motors_of(agents, &robot)?;
        let rules = Rules::new(file, &robot)?;
        check_neighbourhood(&robot, &rules)?;
        let control_ranges = control_ranges(&file.actions, &rules, &robot)?;
        Ok(Self {
            name: name.to_owned(),
            robot,
            agents,
            control_ranges,
            episode_steps: file.episode_steps,
            rules,
        })
    }
}

impl TaskDefinition {
    /// The example of docs/ADDING_A_TASK.md: a hopper with two agents.
    pub fn example() -> Self {
        let file = include_str!("../assets/hopper.toml").to_owned();
        Self { file, model: include_str!("../assets/hopper.xml").to_owned() }
    }

    /// The task file and model of a robot that is part of the program, for tasks of other names. `name` is the robot's or that
    /// of one of its tasks.
    ///
    /// # Errors
    /// If no robot has this name.
    pub fn like(name: &str) -> Result<Self, SimError> {
        let is_it =
            |file: &TaskFile| file.robot == name || file.task_names().any(|task| task == name);
        let Some(index) = FILES.iter().position(|(file, _)| is_it(file)) else {
            let known = FILES.iter().map(|(file, _)| file.robot.as_str());
            let choice = crate::spelling::choice(name, known);
            return Err(refused(format!("no robot of the program is called `{name}`; {choice}")));
        };
        let robot = |of: &str| format!("\nrobot = \"{of}\"");
        let own = &FILES[index].0.robot;
        let file = SHIPPED[index][0].replacen(&robot(own), &robot(&format!("my-{own}")), 1);
        Ok(Self { file, model: SHIPPED[index][1].to_owned() })
    }

    /// Path of the model that a task file names, relative to the file.
    ///
    /// # Errors
    /// If the text is not a valid task file.
    pub fn model_of(file: &str) -> Result<String, SimError> {
        TaskFile::parse(file).map(|file| file.model)
    }

    /// Names of the tasks in the file, sorted; none is that of a task of the program.
    ///
    /// # Errors
    /// If the text is not a valid task file, or a task of the program has one of the names.
    pub fn task_names(&self) -> Result<Vec<String>, SimError> {
        let file = TaskFile::parse(&self.file)?;
        let names: Vec<String> = file.task_names().collect();
        match names.iter().find(|name| task_names().contains(&name.as_str())) {
            None => Ok(names),
            Some(name) => {
                let why = "is part of the program; choose another name for `robot`";
                Err(refused(format!("the task `{name}` {why}")))
            }
        }
    }

    /// Names of the partitions in the file, sorted.
    ///
    /// # Errors
    /// If the text is not a valid task file.
    pub fn partitions(&self) -> Result<Vec<String>, SimError> {
        TaskFile::parse(&self.file).map(|file| file.agents.into_keys().collect())
    }

    /// Builds the task `name` of the file and discards it. Returns the names of the model's bodies and coordinates.
    ///
    /// # Errors
    /// If the file, the model or a name in the file is invalid.
    pub fn check(&self, name: &str) -> Result<Vec<String>, SimError> {
        let robot = Task::build(&TaskFile::parse(&self.file)?, &self.model, name)?.robot;
        Ok([robot.bodies(), robot.coordinate_names()].concat())
    }

    /// The table `settings` of the file, as TOML; empty without one.
    ///
    /// # Errors
    /// If the text is not a valid task file.
    pub fn settings(&self) -> Result<String, SimError> {
        TaskFile::parse(&self.file).map(|file| file.settings.to_string())
    }
}

/// Motors of each agent. A joint's name stands for all its actuators, that of an actuator for one of them; each belongs to
/// exactly one agent.
fn motors_of(agents: &[Vec<String>], robot: &Robot) -> Result<Vec<Vec<usize>>, SimError> {
    let motors = &robot.blueprint.motors;
    if motors.is_empty() {
        let reason =
            "the model has no actuators, so there is nothing to learn; add an <actuator> section";
        return Err(SimError::Model { robot: robot.name().to_owned(), reason: reason.to_owned() });
    }
    if agents.is_empty() {
        return Err(refused("agents: a partition needs at least one agent, such as [[\"hip\"]]"));
    }
    let known: BTreeSet<&String> =
        motors.iter().flat_map(|motor| [&motor.joint, &motor.name]).collect();
    let known: Vec<String> = known.into_iter().cloned().collect();
    let names = Names::new("actuator or joint with one", &known);
    let indices = |is: &dyn Fn(&MotorPlan) -> bool| {
        (0..motors.len()).filter(|&index| is(&motors[index])).collect::<Vec<_>>()
    };
    let mut owned = BTreeSet::new();
    let mut found = Vec::new();
    for (number, actuators) in agents.iter().enumerate() {
        if actuators.is_empty() {
            return Err(refused(format!("agents: agent {number} has no joint")));
        }
        let mut of_agent = Vec::new();
        for name in actuators {
            names.index("agents", name)?;
            let mut named = indices(&|motor| motor.joint == *name);
            if named.is_empty() {
                named = indices(&|motor| motor.name == *name);
            }
            if named.iter().any(|&motor| !owned.insert(motor)) {
                return Err(refused(format!(
                    "agents: `{name}` stands for an actuator that has an agent already; remove one"
                )));
            }
            of_agent.extend(named);
        }
        found.push(of_agent);
    }
    match (0..motors.len()).find(|motor| !owned.contains(motor)) {
        None => Ok(found),
        Some(motor) => {
            let MotorPlan { joint, name, tendon, thrust, .. } = &motors[motor];
            let is_on_joint = tendon.is_none() && thrust.is_none();
            let kind = if is_on_joint && joint == name { "joint" } else { "actuator" };
            Err(refused(format!("agents: the {kind} `{name}` belongs to no agent; add it to one")))
        }
    }
}

/// Checks that the features which `k_nearest` shows exist.
fn check_neighbourhood(robot: &Robot, rules: &Rules) -> Result<(), SimError> {
    let mut features = rules.measured_features(robot);
    features.extend(rules.command.features());
    let first_disturbance = features.len();
    if rules.audience == Audience::Agents {
        features.extend(rules.disturbance_features());
    }
    let features: Vec<String> = features.into_iter().map(|feature| feature.name).collect();
    let state = Names::new("feature that its agents may observe", &features);
    let Neighbourhood { edges, touching, globals } = &robot.neighbourhood;
    if edges.iter().any(|edge| edge.len() < 2) {
        return Err(refused("neighbourhood.edges: an edge needs at least two joints; add one"));
    }
    edges.iter().try_for_each(|edge| check_repeats("neighbourhood.edges", edge))?;
    check_repeats("neighbourhood.globals", globals)?;
    if let Some(row) = touching.iter().find(|row| row.bodies.is_empty()) {
        let why = "has no bodies; name those whose contact forces belong to the joint";
        return Err(refused(format!("neighbourhood.touching: the row of `{}` {why}", row.joint)));
    }
    let near = edges.iter().flatten().map(|joint| ("neighbourhood.edges", joint));
    let touching_joints = touching.iter().map(|row| ("neighbourhood.touching.joint", &row.joint));
    for (key, joint) in near.chain(touching_joints) {
        for part in &robot.numbers_of(joint)[0] {
            // A hidden coordinate is a joint's, too.
            if !robot.coordinate_names().contains(part) {
                state.index(key, &format!("{part}.position"))?;
            }
        }
    }
    let related = rules.related(robot);
    for name in globals {
        let index = state.index("neighbourhood.globals", name)?;
        // A command may be a global, too: the observations of `quadruped` have it twice.
        if index >= first_disturbance || related.contains(&(index, None)) {
            let why = format!("all agents observe `{name}` without it; remove it");
            return Err(refused(format!("neighbourhood.globals: {why}")));
        }
    }
    let bodies = Names::new("body", robot.bodies());
    for body in touching.iter().flat_map(|row| &row.bodies) {
        bodies.index("neighbourhood.touching.bodies", body)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
