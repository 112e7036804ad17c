//! Commands: a target velocity of the root, drawn per episode, which the agents observe and the reward can follow.

use proto::{FeatureRole, FeatureSpec};
use serde::Deserialize;

use super::Motion;
use super::definition::refused;
use super::disturbance::ascending;
use crate::error::SimError;
use crate::noise::{self, DrawPurpose, generator};
use crate::robot::{JointMap, MapKind, Orientation, Robot};

/// Largest target, m/s or rad/s.
const FASTEST_COMMAND: f32 = 100.0;

/// `[command]` of a task file: the ranges `[low, high]` from which targets are drawn. Only what is stated is drawn.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct CommandRow {
    /// m/s along the root's x axis, projected onto the ground.
    forward: Option<[f32; 2]>,
    /// m/s to the left of it.
    sideways: Option<[f32; 2]>,
    /// rad/s about the vertical.
    yaw: Option<[f32; 2]>,
}

/// A component of the target velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Heading {
    /// Along the root's x axis, projected onto the ground.
    Forward,
    /// To the left of it.
    Sideways,
    /// About the vertical.
    Yaw,
}

/// The command of a task.
#[derive(Clone, Debug)]
pub(crate) struct CommandRanges {
    /// Components in the order of their features, with their ranges, m/s or rad/s, `[C]`.
    components: Vec<(Heading, [f32; 2])>,
    root: RootMotion,
}

/// Coordinates and velocities that determine the motion of the root.
#[derive(Clone, Copy, Debug)]
enum RootMotion {
    /// In the plane of x and z; the value is the index of its velocity along x.
    Planar(usize),
    /// Free, with this orientation.
    Free(Orientation),
}

impl Heading {
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::Sideways => "sideways",
            Self::Yaw => "yaw",
        }
    }
}

impl CommandRanges {
    pub(super) fn new(row: &CommandRow, robot: &Robot) -> Result<Self, SimError> {
        let rows = [
            (Heading::Forward, row.forward),
            (Heading::Sideways, row.sideways),
            (Heading::Yaw, row.yaw),
        ];
        let stated = rows.into_iter().filter_map(|(heading, range)| Some((heading, range?)));
        let components: Vec<(Heading, [f32; 2])> = stated.collect();
        for (heading, range) in &components {
            let bounds = [-FASTEST_COMMAND, FASTEST_COMMAND];
            ascending(&format!("command.{}", heading.word()), *range, bounds)?;
        }
        let JointMap { kind, coordinate, velocity, .. } = *robot.layout().root_joint();
        let root = match kind {
            MapKind::Free | MapKind::Floating => {
                RootMotion::Free(Orientation { coordinate: coordinate + 3, velocity: velocity + 3 })
            }
            MapKind::Planar => RootMotion::Planar(velocity),
            _ if components.is_empty() => RootMotion::Planar(velocity),
            _ => return Err(refused("[command] needs a robot with a free or planar root")),
        };
        let turns = components.iter().find(|(heading, _)| *heading != Heading::Forward);
        match (root, turns) {
            (RootMotion::Planar(_), Some((heading, _))) => {
                let why = "needs a robot with a free joint; this one moves in a plane";
                Err(refused(format!("command.{} {why}", heading.word())))
            }
            _ => Ok(Self { components, root }),
        }
    }

    /// Whether the task states no command.
    pub(crate) fn is_empty(&self) -> bool {
        self.components.is_empty()
    }

    /// Index of a component among those of the task.
    pub(super) fn index(&self, heading: Heading) -> Option<usize> {
        self.components.iter().position(|(own, _)| *own == heading)
    }

    /// Components of the task, `[C]`.
    pub(super) fn headings(&self) -> impl Iterator<Item = Heading> {
        self.components.iter().map(|(heading, _)| *heading)
    }

    /// Draws the target of an episode, m/s and rad/s, `[C]`.
    pub(super) fn draw(&self, key: [u8; 32]) -> Vec<f32> {
        let mut rng = generator(key, DrawPurpose::Command, 0);
        self.components.iter().map(|(_, range)| noise::within(&mut rng, *range)).collect()
    }

    /// Features of the target.
    pub(super) fn features(&self) -> Vec<FeatureSpec> {
        let feature = |heading: Heading| FeatureSpec {
            name: format!("command.{}", heading.word()),
            role: FeatureRole::Signal,
        };
        self.headings().map(feature).collect()
    }

    /// What is drawn, one line each.
    pub(super) fn lines(&self) -> Vec<String> {
        let line = |(heading, [low, high]): &(Heading, [f32; 2])| {
            let unit = if *heading == Heading::Yaw { "rad/s" } else { "m/s" };
            format!("command {}: {low} to {high} {unit}, in each episode", heading.word())
        };
        self.components.iter().map(line).collect()
    }

    /// The robot's own velocity along a component, m/s or rad/s. Forward is the root's x axis projected onto the ground;
    /// a root whose x axis is vertical has no forward speed.
    pub(super) fn velocity(&self, heading: Heading, motion: &Motion<'_>) -> f32 {
        let Orientation { coordinate, velocity } = match self.root {
            RootMotion::Planar(along) => return motion.velocities[along],
            RootMotion::Free(orientation) => orientation,
        };
        let velocities = &motion.velocities[velocity - 3..];
        if heading == Heading::Yaw {
            return velocities[5];
        }
        let [w, x, y, z] = std::array::from_fn(|k| motion.coordinates[coordinate + k]);
        let (ahead, aside) = (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z));
        let length = (ahead * ahead + aside * aside).sqrt();
        if length == 0.0 {
            return 0.0;
        }
        let along = match heading {
            Heading::Forward => velocities[0] * ahead + velocities[1] * aside,
            _ => velocities[1] * ahead - velocities[0] * aside,
        };
        along / length
    }
}
