//! A task file: a robot's model, agents, reward, start, end and state as data. TOML, with an MJCF file beside it.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::body_terms::Goal;
use super::command::{CommandRow, Heading};
use super::disturbance::DisturbanceRow;
use super::reading::{typed, whole};
use super::relations::{RelationRow, WorldAxis};
use super::rules::term_names;
use super::start::StartRow;
use crate::arrays;
use crate::error::{SimError, short};
use crate::robot::{Neighbourhood, Orientation, Physics, RobotRow};
use crate::spelling;

/// Content of a task file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TaskFile {
    /// Name of the robot; its tasks are called `ROBOT-PARTITION`.
    pub(crate) robot: String,
    /// Path of the MJCF file, relative to the task file.
    pub(crate) model: String,
    /// Physics steps in an environment step.
    pub(crate) frame_skip: u32,
    /// Steps after which an episode is truncated.
    pub(crate) episode_steps: u32,
    /// Joints of each agent, by the name of the partition.
    pub(crate) agents: BTreeMap<String, Vec<Vec<String>>>,
    /// Terms that are added to the reward, in the order of the sum.
    #[serde(default)]
    pub(crate) reward: Vec<TermRow>,
    /// Terms that are added and then subtracted from the reward, in the order of the sum.
    #[serde(default)]
    pub(crate) cost: Vec<TermRow>,
    /// The episode terminates when one of these conditions does not hold.
    #[serde(default)]
    pub(crate) healthy: Vec<HealthyRow>,
    /// Noise on the rest pose.
    #[serde(default, deserialize_with = "arrays::table")]
    pub(crate) start: StartRow,
    /// Map from actions to controls.
    #[serde(default, deserialize_with = "arrays::table")]
    pub(crate) actions: ActionsRow,
    /// Features of the global state.
    #[serde(default, deserialize_with = "arrays::table")]
    pub(crate) state: StateRow,
    /// Target velocity that the agents observe.
    #[serde(default, deserialize_with = "arrays::table")]
    pub(crate) command: CommandRow,
    /// What disturbs the episodes.
    #[serde(default, deserialize_with = "arrays::table")]
    pub(crate) disturbance: DisturbanceRow,
    #[serde(default, deserialize_with = "arrays::table")]
    neighbourhood: Neighbourhood,
    #[serde(default, deserialize_with = "arrays::table")]
    physics: Physics,
    /// Settings of the learner, in the form of `configs/tasks`; the program checks them.
    #[serde(default)]
    pub(crate) settings: toml::Table,
}

/// A weighted term of the reward.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TermRow {
    pub(crate) term: TermName,
    /// Factor of the term; its unit makes the product one of reward.
    pub(crate) weight: f32,
    /// Coordinate that `in_range` reads.
    pub(crate) coordinate: Option<String>,
    /// Bounds of `in_range`, included.
    #[serde(default, deserialize_with = "arrays::given")]
    pub(crate) range: Option<[f32; 2]>,
    /// Point that `target_distance` measures to, one value per named coordinate, m.
    pub(crate) target: Option<BTreeMap<String, f32>>,
    /// Components of the command that `velocity_tracking` reads.
    pub(crate) components: Option<Vec<Heading>>,
    /// Error of `velocity_tracking`, m/s or rad/s, or distance, m, at which the term is `1 / e`.
    pub(crate) sigma: Option<f32>,
    /// Body that a term measures; absent for `upright`: the root, for `velocity_tracking`: that of the command.
    pub(crate) of: Option<String>,
    /// Body or point that `distance` and `approach` measure to.
    pub(crate) to: Option<Goal>,
    /// Bodies of `spread`.
    pub(crate) bodies: Option<Vec<String>>,
    /// Axes of the world that count; one for `progress`.
    pub(crate) along: Option<Vec<WorldAxis>>,
}

/// Names of the terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum TermName {
    /// [`super::terms::forward_speed`]
    ForwardSpeed,
    /// [`super::terms::alive`]
    Alive,
    /// [`super::terms::control`]
    Control,
    /// [`super::terms::target_distance`]
    TargetDistance,
    /// [`super::terms::upright`]
    Upright,
    /// [`super::terms::in_range`]
    InRange,
    /// [`super::terms::action_rate`]
    ActionRate,
    /// [`super::terms::velocity_tracking`]
    VelocityTracking,
    /// [`super::terms::mass_centre_speed`]
    MassCentreSpeed,
    /// [`super::body_terms::distance`]
    Distance,
    /// [`super::body_terms::approach`]
    Approach,
    /// [`super::body_terms::progress`]
    Progress,
    /// [`super::body_terms::height`]
    Height,
    /// [`super::body_terms::spread`]
    Spread,
}

/// The name in task files.
impl fmt::Display for TermName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Range of a coordinate, in the model's own frame, m or rad, or of a feature.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct HealthyRow {
    pub(crate) coordinate: Option<String>,
    /// A feature of the global state, or `upright`.
    pub(crate) feature: Option<String>,
    /// Body that `upright` measures; absent: the root.
    pub(crate) of: Option<String>,
    /// Lower bound, excluded.
    pub(crate) above: Option<f32>,
    /// Lower bound, included.
    pub(crate) at_least: Option<f32>,
    /// Upper bound, excluded.
    pub(crate) below: Option<f32>,
    /// Upper bound, included.
    pub(crate) at_most: Option<f32>,
}

/// Map from actions to controls.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ActionsRow {
    pub(crate) around: Around,
    /// Change of a servo's control for an action of 1, in the control's unit; absent: half its range.
    pub(crate) scale: Option<f32>,
}

/// Control for an action of 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Around {
    /// The middle of its range.
    #[default]
    Range,
    /// That of the keyframe of the start; without one, the control with which a servo of the position holds the start.
    Start,
}

/// Features of the global state: coordinates, positions of bodies, velocities, those of bodies, the command, contact forces, which are 0, and disturbances.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct StateRow {
    /// Coordinates that are not features.
    pub(crate) hidden: Vec<String>,
    /// Velocities are clipped to plus and minus this value, m/s or rad/s; absent: not clipped.
    pub(crate) largest_velocity: Option<f32>,
    /// Axes of the linear velocities of free joints.
    pub(crate) linear_velocity: Axes,
    /// Axes of a free root's angular velocity.
    pub(crate) angular_velocity: Axes,
    /// Who observes what the episode has drawn of `[disturbance]`.
    pub(crate) disturbances: Audience,
    /// Whether the state may have features of contact forces, which `observation.contact_forces` selects.
    pub(crate) contact_forces: bool,
    /// Features that relate bodies to each other.
    pub(crate) bodies: Vec<RelationRow>,
}

impl StateRow {
    /// First components of the velocities of free joints that are expressed in the axes of their bodies, with the
    /// rotations. The linear velocities precede the angular ones.
    pub(super) fn velocities_in_body(
        &self,
        free: &[Orientation],
    ) -> Result<Vec<(usize, Orientation)>, SimError> {
        let rows = [("linear", self.linear_velocity, 3), ("angular", self.angular_velocity, 0)];
        let rows = rows.into_iter().filter(|(_, axes, _)| *axes == Axes::Body);
        let in_body = |(which, _, before): (&str, Axes, usize)| {
            if free.is_empty() {
                let why = "_velocity = \"body\" needs a robot with a free joint";
                return Err(refused(format!("state.{which}{why}")));
            }
            let first = move |turn: &Orientation| (turn.velocity - before, *turn);
            Ok(free.iter().map(first).collect::<Vec<_>>())
        };
        Ok(rows.map(in_body).collect::<Result<Vec<_>, _>>()?.concat())
    }
}

/// Axes in which a vector is expressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Axes {
    /// Axes of the world.
    #[default]
    World,
    /// Axes of the root.
    Body,
}

/// Who observes the disturbances of an episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Audience {
    /// They are no features of the global state.
    #[default]
    Nobody,
    /// They are features of the global state that no agent observes.
    Critic,
    /// The agents, too.
    Agents,
}

impl TaskFile {
    /// Parses a file and checks everything that does not depend on the robot.
    pub(crate) fn parse(text: &str) -> Result<Self, SimError> {
        let file: Self = typed(text)?;
        let name = |text: &str| {
            let sign = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            (1..=40).contains(&text.len()) && text.chars().all(sign)
        };
        let unnamed = |key: &str, found: &str| {
            let rule = "must be 1 to 40 letters, digits, `-` or `_`";
            Err(refused(format!("{key} {rule}, is `{found}`")))
        };
        if !name(&file.robot) {
            return unnamed("robot", &file.robot);
        }
        if file.model.is_empty() {
            return Err(refused("model is empty; name an MJCF file, such as \"robot.xml\""));
        }
        if let Some(partition) = file.agents.keys().find(|partition| !name(partition)) {
            return unnamed("a key of [agents]", partition);
        }
        if file.agents.is_empty() {
            return Err(refused(
                "[agents] is empty; write, for example, 2x1 = [[\"hip\"], [\"knee\"]]",
            ));
        }
        whole("frame_skip", file.frame_skip)?;
        whole("episode_steps", file.episode_steps)?;
        check_physics(&file.physics)?;
        Ok(file)
    }

    /// Names of the tasks, sorted.
    pub(crate) fn task_names(&self) -> impl Iterator<Item = String> {
        self.agents.keys().map(|partition| format!("{}-{partition}", self.robot))
    }

    /// The weight of the reward term or cost `term`.
    ///
    /// # Errors
    /// If the file has no term of this name.
    pub(crate) fn weight_mut(&mut self, term: &str) -> Result<&mut f32, SimError> {
        let names = term_names(self);
        let mut rows = self.reward.iter_mut().chain(&mut self.cost).zip(&names);
        match rows.find(|(_, name)| *name == term) {
            Some((row, _)) => Ok(&mut row.weight),
            None => {
                let choice = spelling::choice(term, names.iter().map(String::as_str));
                Err(refused(format!("reward.{term}: the task has no such term; {choice}")))
            }
        }
    }

    /// The robot with the MJCF document `mjcf`.
    pub(crate) fn robot_row(&self, mjcf: String) -> RobotRow {
        RobotRow {
            name: self.robot.clone(),
            mjcf,
            frame_skip: self.frame_skip,
            neighbourhood: self.neighbourhood.clone(),
            physics: self.physics.clone(),
        }
    }
}

fn check_physics(physics: &Physics) -> Result<(), SimError> {
    let given = |key: &str, value: Option<f32>, low, high| {
        value.map_or(Ok(()), |value| within(key, value, low, high))
    };
    for (key, row) in [("limits", &physics.limits), ("contacts", &physics.contacts)] {
        let key = |name: &str| format!("physics.{key}.{name}");
        given(&key("time_constant_secs"), row.time_constant_secs, 1e-4, 10.0)?;
        given(&key("width"), row.width, 1e-6, 10.0)?;
        for impedance in row.impedance.into_iter().flatten() {
            within(&key("impedance"), impedance, 0.0, 0.9999)?;
        }
    }
    given("physics.margin", physics.margin, 0.0, 1.0)?;
    given("physics.contact_compliance", physics.contact_compliance, 1e-3, 1.0)
}

/// An error of the task file.
pub(super) fn refused(why: impl Into<String>) -> SimError {
    SimError::Task(why.into())
}

/// Refuses a list with an entry twice.
pub(super) fn check_repeats<T: PartialEq>(key: &str, list: &[T]) -> Result<(), SimError> {
    if (1..list.len()).any(|index| list[..index].contains(&list[index])) {
        Err(refused(format!("{key} names an entry twice; remove one")))
    } else {
        Ok(())
    }
}

/// Largest weight, bound or target, in its unit.
pub(super) const LARGEST_NUMBER: f32 = 1e9;

/// Refuses a number outside `low..=high`, and NaN.
pub(super) fn within(key: &str, value: f32, low: f32, high: f32) -> Result<(), SimError> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        let [low, high, value] = [low, high, value].map(short);
        Err(refused(format!("{key} must lie in {low}..={high}, is {value}")))
    }
}
