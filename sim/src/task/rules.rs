//! Start, reward, end and global state of an episode, as a task file defines them for its robot.

use proto::{FeatureRole, FeatureSpec};
use rand::RngCore;
use rapier3d::math::{Rotation, Vector};

use super::Motion;
use super::command::CommandRanges;
use super::definition::{Audience, Axes, HealthyRow, Noise, StartRow, TaskFile, refused, within};
use super::disturbance::{DisturbanceRanges, DrawnEpisode};
use super::names::Names;
use super::terms::{self, RootTilt, Transition, WeightedSum};
use crate::error::SimError;
use crate::robot::{Keyframe, Robot};
use crate::state::EpisodeDraws;

/// Largest draw of the standard normal distribution in [`crate::noise::normal`]: `sqrt(-2 ln 2^-24)`, rounded up.
const FARTHEST_NORMAL: f32 = 5.77;
/// Largest noise of a quaternion's components. The noise of all four is shorter than the quaternion, which is 1 long.
const LARGEST_TURN: f32 = 0.25;
/// The same for the quaternion (1, 0, 0, 0), whose first component then stays positive.
const LARGEST_TURN_FROM_REST: f32 = 0.5;

/// The start of an episode, with names resolved to indices.
#[derive(Clone, Debug, Default)]
struct Start {
    /// Coordinates that differ from the rest pose.
    coordinates: Vec<(usize, f32)>,
    /// Velocities that are not 0.
    speeds: Vec<(usize, f32)>,
    /// Controls of a keyframe, in the order of the model's actuators; empty without any.
    controls: Vec<f32>,
    positions: Option<Noise>,
    velocities: Option<Noise>,
}

/// A number that ends an episode.
#[derive(Clone, Copy, Debug)]
enum Watched {
    /// Index of a coordinate.
    Coordinate(usize),
    /// Index of a feature of the global state.
    Feature(usize),
    /// Cosine of the root's tilt.
    Upright(RootTilt),
}

/// Rules of an episode, with all names resolved to indices.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    start: Start,
    reward: WeightedSum,
    cost: WeightedSum,
    healthy: Vec<(Watched, HealthyRow)>,
    /// Coordinates in the global state.
    shown: Vec<usize>,
    largest_velocity: Option<f32>,
    /// First coordinate of a free root's quaternion.
    orientation: Option<usize>,
    /// First velocity of the root's rotation, if it is expressed in the root's axes.
    turning_in_body: Option<usize>,
    contact_forces: bool,
    command: CommandRanges,
    disturbance: DisturbanceRanges,
    /// Who observes the disturbances.
    audience: Audience,
    /// Number of features that describe the disturbances.
    described: usize,
}

impl Rules {
    /// Resolves the rules of a task file for its robot.
    pub(super) fn new(file: &TaskFile, robot: &Robot) -> Result<Self, SimError> {
        let names = Names::coordinates(robot);
        let orientation = robot.layout().orientation;
        let command = CommandRanges::new(&file.command, robot)?;
        let shown = shown(&file.state.hidden, names, robot)?;
        let measured = measured_features(&shown, robot);
        let disturbance = DisturbanceRanges::new(&file.disturbance, robot, &measured)?;
        let features: Vec<String> = measured.into_iter().map(|feature| feature.name).collect();
        let healthy = file.healthy.iter().map(|row| checked_healthy(row, robot, &features));
        let rules = Self {
            start: checked_start(&file.start, names, robot)?,
            reward: WeightedSum::new("reward", &file.reward, robot, &command)?,
            cost: WeightedSum::new("cost", &file.cost, robot, &command)?,
            healthy: healthy.collect::<Result<_, _>>()?,
            shown,
            largest_velocity: file.state.largest_velocity,
            orientation,
            turning_in_body: match (file.state.angular_velocity, orientation) {
                (Axes::World, _) => None,
                // A free root's velocities are the first ones: three linear, three angular.
                (Axes::Body, Some(_)) => Some(3),
                (Axes::Body, None) => {
                    let why = "state.angular_velocity = \"body\" needs a robot with a free joint";
                    return Err(refused(why));
                }
            },
            contact_forces: file.state.contact_forces,
            command,
            described: match file.state.disturbances {
                Audience::Nobody => 0,
                Audience::Critic | Audience::Agents => disturbance.features().len(),
            },
            disturbance,
            audience: file.state.disturbances,
        };
        if let Some(largest) = rules.largest_velocity {
            within("state.largest_velocity", largest, 1e-3, 1e6)?;
        }
        Ok(rules)
    }

    /// Coordinates `[nq]` and velocities `[nv]` of the start without noise.
    pub(crate) fn start_pose(&self, robot: &Robot) -> (Vec<f32>, Vec<f32>) {
        let mut coordinates = robot.rest().to_vec();
        let mut velocities = vec![0.0; robot.velocity_names().len()];
        self.start.apply(&mut coordinates, &mut velocities);
        (coordinates, velocities)
    }

    /// The control of a motor in the keyframe of the start, if it has controls.
    pub(super) fn start_control(&self, motor: usize) -> Option<f32> {
        self.start.controls.get(motor).copied()
    }

    /// Turns a rest pose `[nq]` with zero velocities `[nv]` into a start: sets the stated coordinates and adds noise. A
    /// quaternion is normalised.
    pub(crate) fn randomise(
        &self,
        rng: &mut impl RngCore,
        coordinates: &mut [f32],
        velocities: &mut [f32],
    ) {
        self.start.apply(coordinates, velocities);
        if let Some(distribution) = self.start.positions {
            coordinates.iter_mut().for_each(|number| *number += distribution.draw(rng));
        }
        let moves = self.start.positions.is_some() || !self.start.coordinates.is_empty();
        if let (true, Some(first)) = (moves, self.orientation) {
            let quaternion = &mut coordinates[first..first + 4];
            let length = quaternion.iter().map(|q| q * q).sum::<f32>().sqrt();
            quaternion.iter_mut().for_each(|q| *q /= length);
        }
        if let Some(distribution) = self.start.velocities {
            velocities.iter_mut().for_each(|number| *number += distribution.draw(rng));
        }
    }

    /// Reward of a step: the sum of the rewards minus the sum of the costs.
    pub(crate) fn reward(&self, step: &Transition<'_>) -> f32 {
        self.reward.value(step) - self.cost.value(step)
    }

    /// Whether the episode terminates for a reason other than its length: a number has left its healthy range. `state` is
    /// the global state.
    pub(crate) fn terminated(&self, after: &Motion<'_>, state: &[f32]) -> bool {
        let value = |watched: &Watched| match *watched {
            Watched::Coordinate(index) => after.position(index),
            Watched::Feature(index) => state[index],
            Watched::Upright(root) => terms::upright(after, root),
        };
        !self.healthy.iter().all(|(watched, row)| row.holds(value(watched)))
    }

    /// Whether contact forces can be observed.
    pub(crate) fn feels_contacts(&self) -> bool {
        self.contact_forces
    }

    /// Whether the reward depends on the actions of the step before.
    pub(crate) fn reads_last_action(&self) -> bool {
        self.reward.reads_last_action() || self.cost.reads_last_action()
    }

    /// The disturbances that the task states.
    pub(crate) fn disturbance(&self) -> &DisturbanceRanges {
        &self.disturbance
    }

    /// Who observes the disturbances.
    pub(crate) fn audience(&self) -> Audience {
        self.audience
    }

    /// Whether an episode draws anything besides its start.
    pub(crate) fn has_draws(&self) -> bool {
        !self.command.is_empty() || self.disturbance.are_stated()
    }

    /// What an episode draws besides its start, one line each.
    pub(crate) fn drawn_lines(&self) -> Vec<String> {
        [self.command.lines(), self.disturbance.lines()].concat()
    }

    /// Draws the command and the disturbances of an episode.
    pub(crate) fn draw(&self, draws: &EpisodeDraws) -> DrawnEpisode {
        DrawnEpisode { command: self.command.draw(draws.key), ..self.disturbance.draw(draws) }
    }

    /// Measured features of the global state: positions, then velocities, `[M]`.
    pub(crate) fn measured_features(&self, robot: &Robot) -> Vec<FeatureSpec> {
        measured_features(&self.shown, robot)
    }

    /// Features of the command, which follow the measured ones, `[C]`.
    pub(crate) fn command_features(&self) -> Vec<FeatureSpec> {
        self.command.features()
    }

    /// Features of the disturbances, the last ones of the global state; empty if nobody observes them.
    pub(crate) fn disturbance_features(&self) -> Vec<FeatureSpec> {
        let mut features = self.disturbance.features();
        features.truncate(self.described);
        features
    }

    /// Writes the global state: the measured features and the command to the start of `out`, the disturbances to its end.
    /// Features of contact forces, between them, stay as they are.
    pub(crate) fn state(&self, motion: &Motion<'_>, drawn: &DrawnEpisode, out: &mut [f32]) {
        let command = self.shown.len() + motion.velocities.len();
        out[command..][..drawn.command.len()].copy_from_slice(&drawn.command);
        let disturbances = out.len() - self.described;
        self.disturbance.write(drawn, &mut out[disturbances..]);
        let (positions, rest) = out.split_at_mut(self.shown.len());
        for (to, &index) in positions.iter_mut().zip(&self.shown) {
            *to = motion.position(index);
        }
        let velocities = &mut rest[..motion.velocities.len()];
        velocities.copy_from_slice(motion.velocities);
        if let (Some(first), Some(quaternion)) = (self.turning_in_body, self.orientation) {
            let [w, x, y, z] = std::array::from_fn(|k| motion.coordinates[quaternion + k]);
            let [a, b, c] = std::array::from_fn(|k| motion.velocities[first + k]);
            let turning = Rotation::from_xyzw(x, y, z, w).inverse() * Vector::new(a, b, c);
            velocities[first..first + 3].copy_from_slice(&turning.to_array());
        }
        if let Some(largest) = self.largest_velocity {
            velocities.iter_mut().for_each(|v| *v = v.clamp(-largest, largest));
        }
    }
}

impl Start {
    fn apply(&self, coordinates: &mut [f32], velocities: &mut [f32]) {
        self.coordinates.iter().for_each(|(index, value)| coordinates[*index] = *value);
        self.speeds.iter().for_each(|(index, value)| velocities[*index] = *value);
    }
}

impl HealthyRow {
    fn holds(&self, value: f32) -> bool {
        self.above.is_none_or(|bound| bound < value)
            && self.at_least.is_none_or(|bound| bound <= value)
            && self.below.is_none_or(|bound| value < bound)
            && self.at_most.is_none_or(|bound| value <= bound)
    }
}

fn measured_features(shown: &[usize], robot: &Robot) -> Vec<FeatureSpec> {
    let signal = |name| FeatureSpec { name, role: FeatureRole::Signal };
    let positions = shown.iter().map(|&index| &robot.coordinate_names()[index]);
    let positions = positions.map(|name| signal(format!("{name}.position")));
    let velocities = robot.velocity_names().iter();
    positions.chain(velocities.map(|name| signal(format!("{name}.velocity")))).collect()
}

/// Refuses a start that could leave the bounds of a state.
fn checked_start(row: &StartRow, names: Names<'_>, robot: &Robot) -> Result<Start, SimError> {
    let bounds = robot.state_bounds(1);
    let mut start = match &row.keyframe {
        Some(name) => start_of_keyframe(name, robot)?,
        None => Start::default(),
    };
    (start.positions, start.velocities) = (row.positions, row.velocities);
    for (name, value) in &row.coordinates {
        let index = names.index("start.coordinates", name)?;
        start.coordinates.push((index, value - robot.reference()[index]));
    }
    if let Some((index, speed)) =
        start.speeds.iter().find(|(_, speed)| speed.abs() > bounds.fastest)
    {
        let name = &robot.velocity_names()[*index];
        return Err(refused(format!("start.keyframe: the speed of `{name}` is {speed}")));
    }
    farthest("start.velocities", start.velocities, bounds.fastest)?;
    let reach = farthest("start.positions", start.positions, bounds.fastest)?;
    let mut pose = robot.rest().to_vec();
    start.coordinates.iter().for_each(|(index, value)| pose[*index] = *value);
    let turn = bounds.orientation.map_or(0..0, |first| first..first + 4);
    if !turn.is_empty() {
        let place = "start.positions (largest noise of the root's quaternion)";
        let turned = start.coordinates.iter().any(|(index, _)| turn.contains(index));
        within(place, reach, 0.0, if turned { LARGEST_TURN } else { LARGEST_TURN_FROM_REST })?;
        let length = pose[turn.clone()].iter().map(|q| q * q).sum::<f32>().sqrt();
        within("start.coordinates (length of the root's quaternion)", length, 0.99, 1.01)?;
    }
    for (index, (value, [low, high])) in pose.iter().zip(&bounds.coordinates).enumerate() {
        let is_within = value - reach >= *low && value + reach <= *high;
        if !turn.contains(&index) && !is_within {
            let name = &robot.coordinate_names()[index];
            return Err(refused(format!("the start moves `{name}` out of {low}..={high}")));
        }
    }
    Ok(start)
}

/// The start that a keyframe of the model states.
fn start_of_keyframe(name: &str, robot: &Robot) -> Result<Start, SimError> {
    let keyframes = &robot.blueprint().keyframes;
    let known: Vec<String> = keyframes.iter().map(|keyframe| keyframe.name.clone()).collect();
    let index = Names::new("keyframe", &known).index("start.keyframe", name)?;
    let Keyframe { positions, velocities, controls, .. } = &keyframes[index];
    let motors = robot.blueprint().motors.len();
    for (key, list, count) in [
        ("qpos", positions, robot.rest().len()),
        ("qvel", velocities, robot.velocity_names().len()),
        ("ctrl", controls, motors),
    ] {
        let found = list.len();
        if found != count && found != 0 {
            let why = format!("`{key}` has {found} numbers, the robot has {count}");
            return Err(refused(format!("start.keyframe: the {why}")));
        }
    }
    let single = |list: &[f64]| list.iter().map(|number| *number as f32).collect::<Vec<_>>();
    let mut speeds = single(velocities);
    // MuJoCo has the angular velocity of a free root in the root's axes.
    if let (Some(first), [.., _]) = (robot.layout().orientation, speeds.as_slice()) {
        let [w, x, y, z] = std::array::from_fn(|k| {
            positions.get(first + k).map_or(robot.rest()[first + k], |number| *number as f32)
        });
        let turning = Rotation::from_xyzw(x, y, z, w) * Vector::from_slice(&speeds[3..6]);
        speeds[3..6].copy_from_slice(&turning.to_array());
    }
    let positions = single(positions).into_iter().zip(robot.reference()).map(|(at, by)| at - by);
    Ok(Start {
        coordinates: positions.enumerate().collect(),
        speeds: speeds.into_iter().enumerate().collect(),
        controls: single(controls),
        ..Start::default()
    })
}

/// The largest noise that a distribution draws.
fn farthest(key: &str, distribution: Option<Noise>, fastest: f32) -> Result<f32, SimError> {
    let factor = if matches!(distribution, Some(Noise::Normal(_))) { FARTHEST_NORMAL } else { 1.0 };
    let size = distribution.map_or(0.0, Noise::size);
    within(key, size, 0.0, fastest / FARTHEST_NORMAL).map(|()| size * factor)
}

/// Refuses a condition without bounds, or one that no value meets.
fn checked_healthy(
    row: &HealthyRow,
    robot: &Robot,
    features: &[String],
) -> Result<(Watched, HealthyRow), SimError> {
    let (watched, name) = match (&row.coordinate, &row.feature) {
        (Some(name), None) => {
            let index = Names::coordinates(robot).index("healthy.coordinate", name)?;
            (Watched::Coordinate(index), name)
        }
        (None, Some(name)) if name == "upright" => {
            (Watched::Upright(terms::root_tilt("healthy.upright", robot)?), name)
        }
        (None, Some(name)) => {
            let names = Names::new("feature in its global state", features);
            (Watched::Feature(names.index("healthy.feature", name)?), name)
        }
        _ => return Err(refused("healthy needs either a `coordinate` or a `feature`")),
    };
    let place = format!("healthy.{name}");
    let given = [row.above, row.at_least, row.below, row.at_most].into_iter().flatten();
    let (numbers, mut bounds) = (given.clone().count(), given);
    if numbers == 0 {
        let why = "needs a bound: above, at_least, below or at_most";
        return Err(refused(format!("{place} {why}")));
    }
    if let Some(bound) = bounds.find(|bound| !bound.is_finite()) {
        return Err(refused(format!("{place}: a bound must be finite, is {bound}")));
    }
    let low = row.above.into_iter().chain(row.at_least).fold(f32::NEG_INFINITY, f32::max);
    let high = row.below.into_iter().chain(row.at_most).fold(f32::INFINITY, f32::min);
    if low < high {
        Ok((watched, row.clone()))
    } else {
        Err(refused(format!("{place}: the lower bound {low} is not below {high}")))
    }
}

/// Indices of the coordinates that are not hidden.
fn shown(hidden: &[String], names: Names<'_>, robot: &Robot) -> Result<Vec<usize>, SimError> {
    let hidden = hidden.iter().map(|name| names.index("state.hidden", name));
    let hidden = hidden.collect::<Result<Vec<_>, _>>()?;
    Ok((0..robot.coordinate_names().len()).filter(|index| !hidden.contains(index)).collect())
}
