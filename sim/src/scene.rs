//! Shapes and poses of links, for recordings, films and the page.

use std::sync::Arc;

use proto::EnvironmentSpec;
use rapier3d::math::{Pose as Transform, Rotation, Vector};

/// Name of the frame of what is fixed, instead of a link.
pub const WORLD: &str = "world";

/// Most capsules side by side in the drawing of a box.
const MOST_BESIDE: f32 = 5.0;

/// Pose of all robots and objects of a world at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// Frames of all links in the world, each after its parent.
    pub links: Vec<LinkPose>,
    /// Index of the robot's root among the links.
    pub root: usize,
    /// All hinges.
    pub joints: Vec<JointPose>,
}

/// A link's frame in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkPose {
    /// Name of the link.
    pub name: String,
    /// Index of the link that it hangs on; `None` for the first of a tree.
    pub parent: Option<usize>,
    /// Metres.
    pub position: [f32; 3],
    /// Unit quaternion, x y z w.
    pub quaternion: [f32; 4],
}

/// Position and speed of a hinge or slide.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPose {
    /// Name of the joint.
    pub name: String,
    /// Index of the link that it moves.
    pub link: usize,
    /// Radians; metres for a slide.
    pub position: f32,
    /// Radians per second; metres per second for a slide.
    pub velocity: f32,
}

/// One shape of a link, in the link's frame, or of what is fixed to the world.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkShape {
    /// Link that the shape is attached to, or [`WORLD`].
    pub link: String,
    /// Form and size.
    pub shape: Shape,
    /// Metres.
    pub position: [f32; 3],
    /// Unit quaternion, x y z w.
    pub quaternion: [f32; 4],
}

/// Form and size of a shape, in metres.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A cylinder along z with two half-spheres on its ends.
    Capsule {
        /// Half the cylinder's length.
        half_length: f32,
        /// Radius of the cylinder and the half-spheres.
        radius: f32,
    },
    /// A ball.
    Sphere {
        /// Radius of the ball.
        radius: f32,
    },
    /// A box.
    Box {
        /// Half the lengths along x, y and z.
        half_sizes: [f32; 3],
    },
    /// A cylinder along z.
    Cylinder {
        /// Half the cylinder's length.
        half_length: f32,
        /// Radius of the cylinder.
        radius: f32,
    },
    /// An ellipsoid.
    Ellipsoid {
        /// Semi-axes along x, y and z.
        half_sizes: [f32; 3],
    },
    /// The convex hull of a mesh, or the top of a height field.
    Hull(Arc<Hull>),
}

/// A convex polyhedron, or a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Hull {
    /// Corners, metres.
    pub points: Vec<[f32; 3]>,
    /// Indices of corners, anticlockwise seen from outside or above.
    pub triangles: Vec<[u32; 3]>,
}

/// Okabe and Ito's colours, red, green and blue: those of agents, and of series in figures.
pub const OKABE_ITO: [[u8; 3]; 8] = [
    [0x00, 0x72, 0xB2],
    [0xD5, 0x5E, 0x00],
    [0x00, 0x9E, 0x73],
    [0xCC, 0x79, 0xA7],
    [0xE6, 0x9F, 0x00],
    [0x56, 0xB4, 0xE9],
    [0x00, 0x00, 0x00],
    [0xF0, 0xE4, 0x42],
];

/// Colour of a link whose joint this agent drives; grey without one.
#[must_use]
pub fn link_colour(agent: Option<usize>) -> [u8; 3] {
    agent.map_or([152, 158, 164], |agent| OKABE_ITO[agent % OKABE_ITO.len()])
}

/// All points within the radius of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// Ends of the line, metres; equal for a ball.
    pub ends: [[f32; 3]; 2],
    /// Metres.
    pub radius: f32,
}

impl LinkShape {
    /// Capsules in the link's frame that show the shape in films. They are the shape itself for capsules and balls, and
    /// approximate other shapes: they fill a box, a mesh's bounding box, or a cylinder, and round its edges.
    #[must_use]
    pub fn capsules(&self) -> Vec<Capsule> {
        let place = |point: [f32; 3]| {
            let turned = rotated(self.quaternion, point);
            [0, 1, 2].map(|i| self.position[i] + turned[i])
        };
        let capsules = self.shape.capsules();
        capsules.into_iter().map(|c| Capsule { ends: c.ends.map(place), ..c }).collect()
    }
}

impl LinkPose {
    /// Position, metres, and unit quaternion, x y z w, in the frame of another link.
    #[must_use]
    pub fn seen_from(&self, other: &Self) -> ([f32; 3], [f32; 4]) {
        parts(&(other.transform().inverse() * self.transform()))
    }

    fn transform(&self) -> Transform {
        let [x, y, z, w] = self.quaternion;
        Transform::from_parts(Vector::from(self.position), Rotation::from_xyzw(x, y, z, w))
    }

    /// Transforms a point from the link's frame to the world, metres.
    #[must_use]
    pub fn in_world(&self, point_in_link: [f32; 3]) -> [f32; 3] {
        let turned = rotated(self.quaternion, point_in_link);
        [0, 1, 2].map(|i| self.position[i] + turned[i])
    }
}

/// `v + 2 w (u x v) + 2 u x (u x v)`: a vector rotated by the unit quaternion `(u, w)`.
#[must_use]
pub fn rotated([x, y, z, w]: [f32; 4], vector: [f32; 3]) -> [f32; 3] {
    let once = cross([x, y, z], vector);
    let twice = cross([x, y, z], once);
    [0, 1, 2].map(|i| vector[i] + 2.0 * (w * once[i] + twice[i]))
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Agent that controls the joint of each link, or `None`.
#[must_use]
pub fn drivers(description: &EnvironmentSpec, pose: &Pose) -> Vec<Option<usize>> {
    let driver = |joint: &str| {
        description.agents.iter().position(|agent| agent.joints.iter().any(|name| name == joint))
    };
    let mut drivers = vec![None; pose.links.len()];
    for joint in &pose.joints {
        drivers[joint.link] = driver(&joint.name);
    }
    drivers
}

impl Pose {
    /// Frame of the robot's root in the world.
    ///
    /// # Panics
    /// If the pose has no links, which is that of a game.
    #[must_use]
    pub fn root(&self) -> &LinkPose {
        &self.links[self.root]
    }
}

impl Shape {
    /// Middle and half sizes of the smallest box around the shape along its axes, metres.
    pub(crate) fn bounding_box(&self) -> [[f32; 3]; 2] {
        let half_sizes = match *self {
            Self::Sphere { radius } => [radius; 3],
            Self::Capsule { half_length, radius } => [radius, radius, half_length + radius],
            Self::Cylinder { half_length, radius } => [radius, radius, half_length],
            Self::Box { half_sizes } | Self::Ellipsoid { half_sizes } => half_sizes,
            Self::Hull(ref hull) => {
                let [low, high] = hull.bounds();
                return [1.0, -1.0].map(|sign| [0, 1, 2].map(|i| (high[i] + sign * low[i]) / 2.0));
            }
        };
        [[0.0; 3], half_sizes]
    }

    fn capsules(&self) -> Vec<Capsule> {
        let along = |half: f32, radius: f32| {
            vec![Capsule { ends: [[0.0, 0.0, -half], [0.0, 0.0, half]], radius }]
        };
        match *self {
            Self::Capsule { half_length, radius } => along(half_length, radius),
            Self::Sphere { radius } => along(0.0, radius),
            Self::Cylinder { half_length, radius } if half_length >= radius => {
                along(half_length - radius, radius)
            }
            Self::Cylinder { half_length, radius } => filled([radius, radius, half_length]),
            Self::Box { half_sizes } | Self::Ellipsoid { half_sizes } => filled(half_sizes),
            Self::Hull(_) => {
                let [middle, half_sizes] = self.bounding_box();
                let capsules = filled(half_sizes);
                let moved = |end: [f32; 3]| [0, 1, 2].map(|i| middle[i] + end[i]);
                capsules.into_iter().map(|c| Capsule { ends: c.ends.map(moved), ..c }).collect()
            }
        }
    }
}

/// Parallel capsules in a box: along its longest axis, side by side along the next. Plates become thicker.
fn filled(half_sizes: [f32; 3]) -> Vec<Capsule> {
    let mut axes = [0, 1, 2];
    axes.sort_by(|a, b| half_sizes[*b].total_cmp(&half_sizes[*a]));
    let [length, width, height] = axes.map(|axis| half_sizes[axis]);
    let radius = height.max(width / MOST_BESIDE);
    let count = (width / radius).ceil().max(1.0);
    let capsule = |index: f32| {
        let aside =
            (width - radius) * if count > 1.0 { 2.0 * index / (count - 1.0) - 1.0 } else { 0.0 };
        let end = |sign: f32| {
            let mut point = [0.0; 3];
            point[axes[0]] = sign * (length - radius).max(0.0);
            point[axes[1]] = aside;
            point
        };
        Capsule { ends: [end(-1.0), end(1.0)], radius }
    };
    (0..count as u32).map(|index| capsule(index as f32)).collect()
}

impl Hull {
    /// Smallest and largest coordinates.
    pub(crate) fn bounds(&self) -> [[f32; 3]; 2] {
        let start = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        self.points.iter().fold(start, |[low, high], point| {
            [[0, 1, 2].map(|i| low[i].min(point[i])), [0, 1, 2].map(|i| high[i].max(point[i]))]
        })
    }
}

/// A transform as position and quaternion (x y z w).
pub(crate) fn parts(pose: &Transform) -> ([f32; 3], [f32; 4]) {
    (pose.translation.to_array(), pose.rotation.to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_a_metre_in_front_of_its_turned_parent_is_seen_in_front_and_unturned() {
        let half = core::f32::consts::FRAC_1_SQRT_2;
        let link = |parent, position| LinkPose {
            name: "arm".to_owned(),
            parent,
            position,
            // A quarter turn about z, which turns x to y.
            quaternion: [0.0, 0.0, half, half],
        };
        let (parent, child) = (link(None, [1.0, 2.0, 3.0]), link(Some(0), [1.0, 3.0, 3.0]));
        let (position, turn) = child.seen_from(&parent);
        let found = position.iter().chain(&turn);
        let expected = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        assert!(found.zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{position:?}, {turn:?}");
    }

    #[test]
    fn a_quarter_turn_about_y_rotates_z_to_x() {
        let half = core::f32::consts::FRAC_1_SQRT_2;
        let turned = rotated([0.0, half, 0.0, half], [0.0, 0.0, 1.0]);
        let error = turned.iter().zip([1.0, 0.0, 0.0]).map(|(a, b)| (a - b).abs()).sum::<f32>();
        assert!(error < 1e-6, "{turned:?}");
    }
}
