//! Commands: a target velocity of the root or another body, drawn per episode, which the agents observe and the reward can follow.

use std::fmt;

use proto::{FeatureRole, FeatureSpec};
use serde::{Deserialize, Serialize};

use super::Motion;
use super::definition::refused;
use super::disturbance::ascending;
use super::names::Names;
use crate::arrays;
use crate::error::SimError;
use crate::noise::{self, DrawPurpose, generator};
use crate::robot::{JointMap, MapKind, Orientation, Place, PlaceMotion, Robot};

/// A planar root, as messages describe it.
pub(super) const PLANAR_ROOT: &str =
    "planar root (slides along x and z and a hinge about y, in this order, on which nothing acts)";

/// Largest target, m/s or rad/s.
const FASTEST_COMMAND: f32 = 100.0;

/// `[command]` of a task file: the ranges `[low, high]` from which targets are drawn. Only what is stated is drawn.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct CommandRow {
    /// Body whose velocity follows the target; absent: the root.
    pub(super) of: Option<String>,
    /// m/s along its x axis, projected onto the ground.
    #[serde(deserialize_with = "arrays::given")]
    forward: Option<[f32; 2]>,
    /// m/s to the left of it.
    #[serde(deserialize_with = "arrays::given")]
    sideways: Option<[f32; 2]>,
    /// rad/s about the vertical.
    #[serde(deserialize_with = "arrays::given")]
    yaw: Option<[f32; 2]>,
}

/// A component of the target velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Heading {
    /// Along the body's x axis, projected onto the ground.
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
    follower: Follower,
}

/// What determines the motion of the body that follows a command.
#[derive(Clone, Debug)]
enum Follower {
    /// A root in the plane of x and z; the value is the index of its velocity along x.
    Planar(usize),
    /// A free root with this orientation.
    Free(Orientation),
    Body(Place),
}

/// The name in task files.
impl fmt::Display for Heading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl Follower {
    /// The body that the key `of` at `place` names, or the robot's root; refuses components that it cannot follow.
    fn new(
        place: &str,
        of: Option<&str>,
        robot: &Robot,
        components: &[(Heading, [f32; 2])],
    ) -> Result<Self, SimError> {
        let body = |name| Names::new("body", robot.bodies()).index(&format!("{place}.of"), name);
        let body = of.map(body).transpose()?;
        let tree = body.map_or(Some(robot.layout.root), |body| robot.tree_of_body(body));
        let root = tree.map(|link| robot.layout.joints[link]);
        let follower = match root {
            Some(JointMap {
                kind: MapKind::Free | MapKind::Floating,
                coordinate,
                velocity,
                ..
            }) => Self::Free(Orientation { coordinate: coordinate + 3, velocity: velocity + 3 }),
            Some(JointMap { velocity, kind, .. })
                if kind == MapKind::Planar || components.is_empty() =>
            {
                Self::Planar(velocity)
            }
            _ => return Err(refused(format!("{place} needs a free root or a {PLANAR_ROOT}"))),
        };
        let turns = components.iter().find(|(heading, _)| *heading != Heading::Forward);
        if let (Self::Planar(_), Some((heading, _))) = (&follower, turns) {
            let why = "needs a robot with a free joint; this one moves in a plane";
            return Err(refused(format!("command.{heading} {why}")));
        }
        Ok(body.map_or(follower, |body| Self::Body(robot.place(body))))
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
        if components.is_empty() && row.of.is_some() {
            return Err(refused("command.of needs a target: forward, sideways or yaw"));
        }
        for (heading, range) in &components {
            let bounds = [-FASTEST_COMMAND, FASTEST_COMMAND];
            ascending(&format!("command.{heading}"), *range, bounds)?;
        }
        let follower = Follower::new("command", row.of.as_deref(), robot, &components)?;
        Ok(Self { components, follower })
    }

    /// The command as the body that a term at `place` names follows it.
    pub(super) fn of(&self, place: &str, body: &str, robot: &Robot) -> Result<Self, SimError> {
        let follower = Follower::new(place, Some(body), robot, &self.components)?;
        Ok(Self { components: self.components.clone(), follower })
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
    pub(crate) fn features(&self) -> Vec<FeatureSpec> {
        let feature = |heading: Heading| FeatureSpec {
            name: format!("command.{heading}"),
            role: FeatureRole::Signal,
        };
        self.headings().map(feature).collect()
    }

    /// What is drawn, one line each.
    pub(crate) fn lines(&self) -> Vec<String> {
        let line = |(heading, [low, high]): &(Heading, [f32; 2])| {
            let unit = if *heading == Heading::Yaw { "rad/s" } else { "m/s" };
            format!("command {heading}: {low} to {high} {unit}, in each episode")
        };
        self.components.iter().map(line).collect()
    }

    /// The body's own velocity along a component, m/s or rad/s. Forward is its x axis projected onto the ground; a body whose x
    /// axis is vertical has no forward speed.
    pub(super) fn velocity(&self, heading: Heading, motion: &Motion<'_>) -> f32 {
        let (rotation, [along_x, along_y, yaw]) = match &self.follower {
            Follower::Planar(along) => return motion.velocities[*along],
            Follower::Free(orientation) => {
                let velocities = &motion.velocities[orientation.velocity - 3..];
                let rotation = orientation.rotation(motion.coordinates);
                (rotation.to_array(), [velocities[0], velocities[1], velocities[5]])
            }
            Follower::Body(place) => {
                let PlaceMotion { rotation, velocity, spin, .. } = motion.of(place);
                let speeds = [velocity.x, velocity.y, spin.z].map(|speed| speed as f32);
                (rotation.to_array().map(|part| part as f32), speeds)
            }
        };
        if heading == Heading::Yaw {
            return yaw;
        }
        let [x, y, z, w] = rotation;
        let (ahead, aside) = (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z));
        let length = (ahead * ahead + aside * aside).sqrt();
        if length == 0.0 {
            return 0.0;
        }
        let along = match heading {
            Heading::Forward => along_x * ahead + along_y * aside,
            _ => along_y * ahead - along_x * aside,
        };
        along / length
    }
}
