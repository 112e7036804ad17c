//! Ends of episodes: a number that leaves its bounds, as `[[healthy]]` states them.

use super::Motion;
use super::definition::{HealthyRow, LARGEST_NUMBER, refused, within};
use super::names::Names;
use super::terms::{self, Tilt};
use crate::error::{SimError, short};
use crate::robot::Robot;

/// The bounds of a coordinate, in words.
pub(super) const WIDER: &str = " (a joint's limits, 3 rad or m wider)";

/// Where the bounds of a number come from, in words; none for components of rotations.
pub(super) fn origin([low, high]: [f32; 2]) -> &'static str {
    if low < -1.0 || high > 1.0 { WIDER } else { "" }
}

/// A number that ends an episode.
#[derive(Clone, Debug)]
pub(super) enum Watched {
    /// Index of a coordinate.
    Coordinate(usize),
    /// Index of a feature of the global state.
    Feature(usize),
    /// Cosine of a tilt.
    Upright(Tilt),
}

impl Watched {
    /// The least and largest value that it can have. `name` is its coordinate or feature.
    fn range(&self, robot: &Robot, name: &str, largest_velocity: Option<f32>) -> [f32; 2] {
        let position = name.strip_suffix(".position");
        let of_coordinate = match self {
            Self::Coordinate(index) => Some(*index),
            _ => robot.coordinate_names().iter().position(|own| Some(own.as_str()) == position),
        };
        let component = position.and_then(|name| name.rsplit('.').next()).unwrap_or_default();
        let is_relation = of_coordinate.is_none();
        if is_relation && component == "qw" {
            [0.0, 1.0]
        } else if matches!(self, Self::Upright(_))
            || (is_relation && ["qx", "qy", "qz"].contains(&component))
        {
            [-1.0, 1.0]
        } else if let Some(index) = of_coordinate {
            reachable(robot, index)
        } else {
            let is_velocity = matches!(self, Self::Feature(_)) && name.ends_with(".velocity");
            let largest = largest_velocity.filter(|_| is_velocity);
            largest.map_or([f32::NEG_INFINITY, f32::INFINITY], |largest| [-largest, largest])
        }
    }

    /// Its value in a motion with the global state `state`.
    pub(super) fn value(&self, motion: &Motion<'_>, state: &[f32]) -> f32 {
        match self {
            Self::Coordinate(index) => motion.position(*index),
            Self::Feature(index) => state[*index],
            Self::Upright(tilt) => terms::upright(motion, tilt),
        }
    }
}

/// The values that a coordinate has before the state is out of bounds, which ends the episode: a joint's limits, 3 rad or m
/// wider.
pub(super) fn reachable(robot: &Robot, index: usize) -> [f32; 2] {
    let mut turns = robot.layout.quaternions();
    if turns.any(|first| (first..first + 4).contains(&index)) {
        return [-1.0, 1.0];
    }
    robot.layout.coordinate_bounds[index].map(|end| end + robot.reference()[index])
}

impl HealthyRow {
    /// The coordinate or feature.
    pub(super) fn name(&self) -> &str {
        self.coordinate.as_deref().or(self.feature.as_deref()).unwrap_or_default()
    }

    /// Its bounds with their keys.
    fn stated(&self) -> [(&'static str, Option<f32>); 4] {
        [
            ("above", self.above),
            ("at_least", self.at_least),
            ("below", self.below),
            ("at_most", self.at_most),
        ]
    }

    /// The stated bounds, as in the file.
    pub(super) fn bounds(&self) -> String {
        let stated = self.stated().into_iter();
        let stated = stated.filter_map(|(key, bound)| Some(format!("{key} = {}", short(bound?))));
        stated.collect::<Vec<_>>().join(", ")
    }

    pub(super) fn holds(&self, value: f32) -> bool {
        self.above.is_none_or(|bound| bound < value)
            && self.at_least.is_none_or(|bound| bound <= value)
            && self.below.is_none_or(|bound| value < bound)
            && self.at_most.is_none_or(|bound| value <= bound)
    }
}

/// Refuses a condition without bounds, with one that has no effect, or that no value meets.
pub(super) fn checked_healthy(
    row: &HealthyRow,
    robot: &Robot,
    features: &[String],
    largest_velocity: Option<f32>,
) -> Result<(Watched, HealthyRow), SimError> {
    if row.of.is_some() && row.feature.as_deref() != Some("upright") {
        return Err(refused("healthy has the key `of` only with `feature = \"upright\"`"));
    }
    let (watched, name) = match (&row.coordinate, &row.feature) {
        (Some(name), None) => {
            let index = Names::coordinates(robot).index("healthy.coordinate", name)?;
            (Watched::Coordinate(index), name)
        }
        (None, Some(name)) if name == "upright" => {
            let tilt = Tilt::new("healthy.upright", row.of.as_deref(), robot)?;
            (Watched::Upright(tilt), name)
        }
        (None, Some(name)) => {
            check_measured(name, features, robot)?;
            let names = Names::new("feature in its global state", features);
            (Watched::Feature(names.index("healthy.feature", name)?), name)
        }
        _ => return Err(refused("healthy needs either a `coordinate` or a `feature`")),
    };
    let place = format!("healthy.{name}");
    let bounds = row.stated();
    if bounds.iter().all(|(_, bound)| bound.is_none()) {
        let why = "needs a bound: above, at_least, below or at_most";
        return Err(refused(format!("{place} {why}")));
    }
    for (key, bound) in bounds {
        let bound = bound.unwrap_or(0.0);
        within(&format!("{place}.{key}"), bound, -LARGEST_NUMBER, LARGEST_NUMBER)?;
    }
    check_effects(&place, row, watched.range(robot, name, largest_velocity))?;
    let low = row.above.into_iter().chain(row.at_least).fold(f32::NEG_INFINITY, f32::max);
    let high = row.below.into_iter().chain(row.at_most).fold(f32::INFINITY, f32::min);
    if low < high {
        Ok((watched, row.clone()))
    } else {
        Err(refused(format!(
            "{place}: the lower bound {low} (above, at_least) is not below {high} (below, at_most)"
        )))
    }
}

/// Refuses a feature that exists but cannot be in `healthy`, with the reason.
fn check_measured(name: &str, measured: &[String], robot: &Robot) -> Result<(), SimError> {
    let coordinate = name.strip_suffix(".position").unwrap_or_default();
    let is_measured = measured.iter().any(|own| own == name);
    if !is_measured && robot.coordinate_names().iter().any(|own| own == coordinate) {
        let instead = format!("write `coordinate = \"{coordinate}\"`");
        return Err(refused(format!("healthy.feature: state.hidden hides `{name}`; {instead}")));
    }
    let is_drawn = ["command.", "disturbance."].iter().any(|start| name.starts_with(start));
    if !is_measured && is_drawn {
        let why = "is drawn, not measured; name a position or a velocity";
        return Err(refused(format!("healthy.feature: `{name}` {why}")));
    }
    Ok(())
}

/// Refuses a bound that a number in `range` never leaves.
fn check_effects(place: &str, row: &HealthyRow, [low, high]: [f32; 2]) -> Result<(), SimError> {
    let never_acts = |key: &str, bound: f32| match key {
        "above" => bound < low,
        "at_least" => bound <= low,
        "below" => bound > high,
        _ => bound >= high,
    };
    let mut bounds = row.stated().into_iter().filter_map(|(key, bound)| Some((key, bound?)));
    match bounds.find(|(key, bound)| never_acts(key, *bound)) {
        None => Ok(()),
        Some((key, bound)) => {
            let is_velocity = place.ends_with(".velocity");
            let why = if is_velocity { ", by state.largest_velocity" } else { origin([low, high]) };
            let [bound, low, high] = [bound, low, high].map(short);
            Err(refused(format!(
                "{place}.{key} = {bound} has no effect, since the number is always in {low}..={high}{why}; remove the bound \
                 or change it"
            )))
        }
    }
}
