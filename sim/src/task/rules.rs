//! Start, reward, end and global state of an episode, as a task file defines them for its robot.

use proto::{FeatureRole, FeatureSpec};
use rand::RngCore;
use rapier3d::math::{Rotation, Vector};

use super::Motion;
use super::definition::{Axes, HealthyRow, Noise, StartRow, TaskFile, refused, within};
use super::names::Names;
use super::terms::{Transition, WeightedSum};
use crate::error::SimError;
use crate::noise;
use crate::robot::Robot;

/// Largest draw of the standard normal distribution in [`noise::normal`]: `sqrt(-2 ln 2^-24)`, rounded up.
const FARTHEST_NORMAL: f32 = 5.77;
/// Largest noise of a quaternion's components. The noise of all four is shorter than the quaternion, which is 1 long.
const LARGEST_TURN: f32 = 0.25;
/// The same for the quaternion (1, 0, 0, 0), whose first component then stays positive.
const LARGEST_TURN_FROM_REST: f32 = 0.5;

/// The start of an episode, with names resolved to indices.
#[derive(Clone, Debug)]
struct Start {
    /// Coordinates that differ from the rest pose.
    coordinates: Vec<(usize, f32)>,
    positions: Option<Noise>,
    velocities: Option<Noise>,
}

/// Rules of an episode, with all names resolved to indices.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    start: Start,
    reward: WeightedSum,
    cost: WeightedSum,
    healthy: Vec<(usize, HealthyRow)>,
    /// Coordinates in the global state.
    shown: Vec<usize>,
    largest_velocity: Option<f32>,
    /// First coordinate of a free root's quaternion.
    orientation: Option<usize>,
    /// First velocity of the root's rotation, if it is expressed in the root's axes.
    turning_in_body: Option<usize>,
    contact_forces: bool,
}

impl Rules {
    /// Resolves the rules of a task file for its robot.
    pub(super) fn new(file: &TaskFile, robot: &Robot) -> Result<Self, SimError> {
        let names = Names::coordinates(robot);
        let orientation = robot.layout().orientation;
        let rules = Self {
            start: checked_start(&file.start, names, robot)?,
            reward: WeightedSum::new("reward", &file.reward, robot)?,
            cost: WeightedSum::new("cost", &file.cost, robot)?,
            healthy: file
                .healthy
                .iter()
                .map(|row| checked_healthy(row, names))
                .collect::<Result<_, _>>()?,
            shown: shown(&file.state.hidden, names, robot)?,
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
        };
        if let Some(largest) = rules.largest_velocity {
            within("state.largest_velocity", largest, 1e-3, 1e6)?;
        }
        Ok(rules)
    }

    /// Turns a rest pose `[nq]` with zero velocities `[nv]` into a start: sets the stated coordinates and adds noise. A
    /// quaternion is normalised.
    pub(crate) fn randomise(
        &self,
        rng: &mut impl RngCore,
        coordinates: &mut [f32],
        velocities: &mut [f32],
    ) {
        self.start.coordinates.iter().for_each(|(index, value)| coordinates[*index] = *value);
        if let Some(distribution) = self.start.positions {
            coordinates.iter_mut().for_each(|number| *number += draw(distribution, rng));
        }
        let moves = self.start.positions.is_some() || !self.start.coordinates.is_empty();
        if let (true, Some(first)) = (moves, self.orientation) {
            let quaternion = &mut coordinates[first..first + 4];
            let length = quaternion.iter().map(|q| q * q).sum::<f32>().sqrt();
            quaternion.iter_mut().for_each(|q| *q /= length);
        }
        if let Some(distribution) = self.start.velocities {
            velocities.iter_mut().for_each(|number| *number += draw(distribution, rng));
        }
    }

    /// Reward of a step: the sum of the rewards minus the sum of the costs.
    pub(crate) fn reward(&self, step: &Transition<'_>) -> f32 {
        self.reward.value(step) - self.cost.value(step)
    }

    /// Whether the episode terminates for a reason other than its length: a coordinate has left its healthy range.
    pub(crate) fn terminated(&self, after: &Motion<'_>) -> bool {
        !self.healthy.iter().all(|(index, row)| row.holds(after.position(*index)))
    }

    /// Whether contact forces can be observed.
    pub(crate) fn feels_contacts(&self) -> bool {
        self.contact_forces
    }

    /// Whether the reward depends on the actions of the step before.
    pub(crate) fn reads_last_action(&self) -> bool {
        self.reward.reads_last_action() || self.cost.reads_last_action()
    }

    /// Features of the global state, without contact forces: positions, then velocities.
    pub(crate) fn state_features(&self, robot: &Robot) -> Vec<FeatureSpec> {
        let signal = |name| FeatureSpec { name, role: FeatureRole::Signal };
        let positions = self.shown.iter().map(|&index| &robot.coordinate_names()[index]);
        let positions = positions.map(|name| signal(format!("{name}.position")));
        let velocities = robot.velocity_names().iter();
        positions.chain(velocities.map(|name| signal(format!("{name}.velocity")))).collect()
    }

    /// Writes the global state, without contact forces, to the start of `out`.
    pub(crate) fn state(&self, motion: &Motion<'_>, out: &mut [f32]) {
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

impl HealthyRow {
    fn holds(&self, value: f32) -> bool {
        self.above.is_none_or(|bound| bound < value)
            && self.at_least.is_none_or(|bound| bound <= value)
            && self.below.is_none_or(|bound| value < bound)
            && self.at_most.is_none_or(|bound| value <= bound)
    }
}

fn draw(distribution: Noise, rng: &mut impl RngCore) -> f32 {
    match distribution {
        Noise::Uniform(width) => noise::symmetric(rng, width),
        Noise::Normal(deviation) => deviation * noise::normal(rng),
    }
}

/// Refuses a start that could leave the bounds of a state.
fn checked_start(row: &StartRow, names: Names<'_>, robot: &Robot) -> Result<Start, SimError> {
    let bounds = robot.state_bounds(1);
    let index = |(name, value): (&String, &f32)| {
        names.index("start.coordinates", name).map(|index| (index, *value))
    };
    let start = Start {
        coordinates: row.coordinates.iter().map(index).collect::<Result<_, _>>()?,
        positions: row.positions,
        velocities: row.velocities,
    };
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

/// The largest noise that a distribution draws.
fn farthest(key: &str, distribution: Option<Noise>, fastest: f32) -> Result<f32, SimError> {
    let (size, factor) = match distribution {
        None => (0.0, 0.0),
        Some(Noise::Uniform(width)) => (width, 1.0),
        Some(Noise::Normal(deviation)) => (deviation, FARTHEST_NORMAL),
    };
    within(key, size, 0.0, fastest / FARTHEST_NORMAL).map(|()| size * factor)
}

/// Refuses a condition without bounds, or one that no value meets.
fn checked_healthy(row: &HealthyRow, names: Names<'_>) -> Result<(usize, HealthyRow), SimError> {
    let place = format!("healthy.{}", row.coordinate);
    let index = names.index("healthy.coordinate", &row.coordinate)?;
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
        Ok((index, row.clone()))
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
