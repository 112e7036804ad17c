//! The start of an episode: a pose or keyframe, and its noise.

use std::collections::BTreeMap;
use std::fmt;

use rand::RngCore;
use rapier3d::math::Vector;
use serde::Deserialize;

use super::definition::{refused, within};
use super::healthy::WIDER;
use super::names::Names;
use crate::error::{SimError, short};
use crate::noise;
use crate::robot::{Keyframe, Robot};
use crate::state::normalise;

/// Largest draw of the standard normal distribution in [`crate::noise::normal`]: `sqrt(-2 ln 2^-24)`, rounded up.
const FARTHEST_NORMAL: f32 = 5.77;
/// Largest noise of a quaternion's components. The noise of all four is shorter than the quaternion, which is 1 long.
const LARGEST_TURN: f32 = 0.25;
/// The same for the quaternion (1, 0, 0, 0), whose first component then stays positive.
const LARGEST_TURN_FROM_REST: f32 = 0.5;

/// What to do about a coordinate outside its bounds.
const CHANGE: &str = "change it by start.coordinates, in rad or m";
/// The same, if its range suggests degrees.
const IN_DEGREES: &str = "if the ranges of the model are in degrees, set `angle=\"degree\"` of the <compiler>, else change it by \
                          start.coordinates, in rad";

/// The start of an episode: the rest pose, with other values for some coordinates and with noise.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StartRow {
    /// Keyframe of the model whose positions, velocities and controls replace the rest pose.
    pub(crate) keyframe: Option<String>,
    /// Values of coordinates instead of those of the rest pose, m or rad.
    #[serde(default)]
    pub(crate) coordinates: BTreeMap<String, f32>,
    /// Noise on each coordinate, m or rad. A quaternion is normalised after it.
    pub(crate) positions: Option<Noise>,
    /// Noise on single coordinates instead of `positions`.
    #[serde(default)]
    pub(crate) noise: BTreeMap<String, Noise>,
    /// Noise on each velocity, m/s or rad/s.
    pub(crate) velocities: Option<Noise>,
}

/// A distribution around 0.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Noise {
    /// Uniform in plus and minus this value.
    Uniform(f32),
    /// Normal with this standard deviation.
    Normal(f32),
}

impl Noise {
    /// Draws a number.
    pub(super) fn draw(self, rng: &mut impl RngCore) -> f32 {
        match self {
            Self::Uniform(width) => noise::symmetric(rng, width),
            Self::Normal(deviation) => deviation * noise::normal(rng),
        }
    }

    /// Half width or standard deviation.
    pub(super) fn size(self) -> f32 {
        match self {
            Self::Uniform(size) | Self::Normal(size) => size,
        }
    }
}

/// `uniform 0.1`
impl fmt::Display for Noise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if matches!(self, Self::Uniform(_)) { "uniform" } else { "normal" };
        write!(f, "{name} {}", self.size())
    }
}

/// The start of an episode, with names resolved to indices.
#[derive(Clone, Debug, Default)]
pub(crate) struct Start {
    /// Coordinates that differ from the rest pose.
    coordinates: Vec<(usize, f32)>,
    /// Velocities that are not 0.
    speeds: Vec<(usize, f32)>,
    /// Controls of a keyframe, in the order of the model's actuators; empty without any.
    pub(super) controls: Vec<f32>,
    /// Activations of a keyframe; empty without any.
    activations: Vec<f32>,
    /// First coordinate of each unit quaternion.
    orientations: Vec<usize>,
    /// Noise of each coordinate, `[nq]`.
    positions: Vec<Option<Noise>>,
    velocities: Option<Noise>,
}

impl Start {
    /// Resolves a row, and refuses a start that could leave the bounds of a state.
    pub(super) fn new(row: &StartRow, names: Names<'_>, robot: &Robot) -> Result<Self, SimError> {
        let bounds = robot.state_bounds(1);
        let mut start = match &row.keyframe {
            Some(name) => start_of_keyframe(name, robot)?,
            None => Self::default(),
        };
        start.positions = vec![row.positions; bounds.coordinates.len()];
        let reach = farthest("start.positions", row.positions, bounds.fastest)?;
        let mut reaches = vec![reach; bounds.coordinates.len()];
        for (name, noise) in &row.noise {
            let index = names.index("start.noise", name)?;
            start.positions[index] = Some(*noise);
            reaches[index] = farthest("start.noise", Some(*noise), bounds.fastest)?;
        }
        start.velocities = row.velocities;
        for (name, value) in &row.coordinates {
            let index = names.index("start.coordinates", name)?;
            start.coordinates.push((index, value - robot.reference()[index]));
        }
        let reach = farthest("start.velocities", start.velocities, bounds.fastest)?;
        start.check_speeds(robot, bounds.fastest - reach)?;
        for (activation, [low, high]) in start.activations.iter().zip(&bounds.activations) {
            within("start.keyframe (an activation)", *activation, *low, *high)?;
        }
        let names = robot.coordinate_names();
        let key = |index: usize| key_of(row, &names[index..=index]);
        let mut pose = robot.rest().to_vec();
        start.coordinates.iter().for_each(|(index, value)| pose[*index] = *value);
        for first in &bounds.orientations {
            let turn = *first..first + 4;
            let turned = start.coordinates.iter().any(|(index, _)| turn.contains(index));
            let of_turn = turn.clone().map(|index| (index, reaches[index]));
            let (noisiest, reach) =
                of_turn.fold((*first, 0.0), |most, own| if own.1 > most.1 { own } else { most });
            let most = if turned { LARGEST_TURN } else { LARGEST_TURN_FROM_REST };
            if reach > most {
                let what =
                    format!("the noise of `{}` is at most {}", names[noisiest], short(reach));
                let why = format!("allowed is {most}; normal noise ends at 5.77 deviations");
                return Err(refused(format!("start.positions and start.noise: {what}, {why}")));
            }
            let length = pose[turn.clone()].iter().map(|q| q * q).sum::<f32>().sqrt();
            within(&place_of_quaternion(row, &names[turn]), length, 0.99, 1.01)?;
        }
        let turns = |index: usize| {
            bounds.orientations.iter().any(|first| (*first..first + 4).contains(&index))
        };
        for (index, (value, bounds)) in pose.iter().zip(&bounds.coordinates).enumerate() {
            let (place, offset) =
                (format!("{}: `{}`", key(index), names[index]), robot.reference()[index]);
            if !turns(index) {
                let advice = if robot.has_range_in_degrees(index) { IN_DEGREES } else { CHANGE };
                let bounds = (*bounds, advice);
                check_coordinate(&place, (*value, reaches[index]), bounds, offset)?;
            }
        }
        start.orientations.clone_from(&bounds.orientations);
        Ok(start)
    }

    /// Refuses speeds above `slowest`, which the noise would raise above the bounds of a state.
    fn check_speeds(&self, robot: &Robot, slowest: f32) -> Result<(), SimError> {
        let fast = self.speeds.iter().find(|(_, speed)| speed.abs() > slowest);
        let Some((index, speed)) = fast else { return Ok(()) };
        let name = &robot.velocity_names()[*index];
        let most = format!("at most {slowest} with the noise of start.velocities");
        Err(refused(format!("start.keyframe: the speed of `{name}` is {speed}, {most}")))
    }

    /// Sets what differs from the rest pose without motion.
    pub(super) fn apply(&self, coordinates: &mut [f32], velocities: &mut [f32]) {
        self.coordinates.iter().for_each(|(index, value)| coordinates[*index] = *value);
        self.speeds.iter().for_each(|(index, value)| velocities[*index] = *value);
    }

    /// Sets activations `[m]` to those of the keyframe, if it has any.
    pub(crate) fn set_activations(&self, activations: &mut [f32]) {
        activations.iter_mut().zip(&self.activations).for_each(|(to, stated)| *to = *stated);
    }

    /// Turns a rest pose `[nq]` with zero velocities `[nv]` into a start: sets the stated coordinates and adds noise.
    /// Quaternions are normalised.
    pub(crate) fn randomise(
        &self,
        rng: &mut impl RngCore,
        coordinates: &mut [f32],
        velocities: &mut [f32],
    ) {
        self.apply(coordinates, velocities);
        for (number, distribution) in coordinates.iter_mut().zip(&self.positions) {
            if let Some(distribution) = distribution {
                *number += distribution.draw(rng);
            }
        }
        if self.positions.iter().any(Option::is_some) || !self.coordinates.is_empty() {
            for first in &self.orientations {
                normalise(&mut coordinates[*first..first + 4]);
            }
        }
        if let Some(distribution) = self.velocities {
            velocities.iter_mut().for_each(|number| *number += distribution.draw(rng));
        }
    }
}

/// The key that states one of these coordinates of the start.
fn key_of(row: &StartRow, names: &[String]) -> &'static str {
    match &row.keyframe {
        _ if names.iter().any(|name| row.coordinates.contains_key(name)) => "start.coordinates",
        Some(_) => "start.keyframe",
        None => "the model's start",
    }
}

/// Where a quaternion of the start with these coordinates is stated.
fn place_of_quaternion(row: &StartRow, names: &[String]) -> String {
    let key = key_of(row, names);
    format!("{key} (length of the quaternion `{}` to `{}`)", names[0], names[names.len() - 1])
}

/// The start that a keyframe of the model states.
fn start_of_keyframe(name: &str, robot: &Robot) -> Result<Start, SimError> {
    let keyframes = &robot.blueprint.keyframes;
    let known: Vec<String> = keyframes.iter().map(|keyframe| keyframe.name.clone()).collect();
    let index = Names::new("keyframe", &known).index("start.keyframe", name)?;
    let Keyframe { positions, velocities, controls, activations, .. } = &keyframes[index];
    let motors = robot.blueprint.motors.len();
    for (key, list, count) in [
        ("qpos", positions, robot.rest().len()),
        ("qvel", velocities, robot.velocity_names().len()),
        ("ctrl", controls, motors),
        ("act", activations, robot.activations().count()),
    ] {
        let found = list.len();
        if found != count && found != 0 {
            let what = format!("start.keyframe: `{key}` of the keyframe `{name}`");
            let why =
                format!("has {found} numbers, the robot has {count}; correct it in the model");
            return Err(refused(format!("{what} {why}, or name another keyframe")));
        }
    }
    let single = |list: &[f64]| list.iter().map(|number| *number as f32).collect::<Vec<_>>();
    let mut speeds = single(velocities);
    let mut positions = positions.clone();
    if !positions.is_empty() {
        for first in robot.layout.quaternions() {
            let quaternion = &mut positions[first..first + 4];
            let length = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
            if length > 0.0 {
                quaternion.iter_mut().for_each(|q| *q /= length);
            } else {
                // As in MuJoCo.
                quaternion.copy_from_slice(&[1.0, 0.0, 0.0, 0.0])
            }
        }
    }
    let pose = if positions.is_empty() { robot.rest().to_vec() } else { single(&positions) };
    // MuJoCo has the angular velocity of a free joint in the axes of its body.
    for orientation in robot.layout.orientations.iter().filter(|_| !velocities.is_empty()) {
        let turning = &mut speeds[orientation.velocity..][..3];
        let rotation = orientation.rotation(&pose);
        turning.copy_from_slice(&(rotation * Vector::from_slice(turning)).to_array());
    }
    let positions = single(&positions).into_iter().zip(robot.reference()).map(|(at, by)| at - by);
    Ok(Start {
        coordinates: positions.enumerate().collect(),
        speeds: speeds.into_iter().enumerate().collect(),
        controls: single(controls),
        activations: single(activations),
        ..Start::default()
    })
}

/// Refuses a coordinate that its noise can move out of the bounds of a state, with advice for one that is outside without
/// noise. All are relative to the reference `offset`.
fn check_coordinate(
    place: &str,
    (value, reach): (f32, f32),
    ([low, high], advice): ([f32; 2], &str),
    offset: f32,
) -> Result<(), SimError> {
    let is_inside = |reach: f32| value - reach >= low && value + reach <= high;
    if is_inside(reach) {
        return Ok(());
    }
    let [at, lowest, highest] = [value, low, high].map(|number| short(number + offset));
    let noise = if reach > 0.0 { format!(" ± {}", short(reach)) } else { String::new() };
    let remedy = if reach > 0.0 && is_inside(0.0) {
        "lower its noise in start.positions or start.noise"
    } else {
        advice
    };
    let bounds = format!("{lowest}..={highest}{WIDER}");
    Err(refused(format!("{place} starts at {at}{noise}, outside {bounds}; {remedy}")))
}

/// The largest noise that a distribution draws.
fn farthest(key: &str, distribution: Option<Noise>, fastest: f32) -> Result<f32, SimError> {
    let factor = if matches!(distribution, Some(Noise::Normal(_))) { FARTHEST_NORMAL } else { 1.0 };
    let size = distribution.map_or(0.0, Noise::size);
    within(key, size, 0.0, fastest / FARTHEST_NORMAL).map(|()| size * factor)
}
