//! Shapes and poses of links, for recordings, films and the page.

use std::f32::consts::FRAC_1_SQRT_2;
use std::sync::Arc;

use rapier3d::math::{Pose as Transform, Rotation, Vector};

use crate::environment_batch::EnvironmentBatch;
use crate::robot::Robot;

/// Name of the frame of what is fixed, instead of a link.
pub const WORLD: &str = "world";

/// Most capsules side by side in the drawing of a box; thin ones have gaps between them.
const MOST_BESIDE: f32 = 5.0;

/// Corners of a regular octagon on the unit circle.
const OCTAGON: [[f32; 2]; 8] = [
    [1.0, 0.0],
    [FRAC_1_SQRT_2, FRAC_1_SQRT_2],
    [0.0, 1.0],
    [-FRAC_1_SQRT_2, FRAC_1_SQRT_2],
    [-1.0, 0.0],
    [-FRAC_1_SQRT_2, -FRAC_1_SQRT_2],
    [0.0, -1.0],
    [FRAC_1_SQRT_2, -FRAC_1_SQRT_2],
];

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
    /// approximate other shapes: they fill a box or a cylinder from within and round its edges; a flat cylinder is a ring with a
    /// spoke. A mesh is drawn as its bounding box, an ellipsoid as a ring or bars of its size.
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

/// For each link of a pose the agent whose actuator moves it: one of its own joint, else one of a tendon or site.
#[must_use]
pub fn drivers(world: &dyn EnvironmentBatch) -> Vec<Option<usize>> {
    let mut drivers = vec![None; world.pose(0).links.len()];
    let agents = &world.description().agents;
    for (joint, links) in world.robot().into_iter().flat_map(Robot::moved_links) {
        let agent = agents.iter().position(|agent| agent.joints.iter().any(|name| name == joint));
        links.into_iter().for_each(|link| drivers[link] = drivers[link].or(agent));
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
            Self::Cylinder { half_length, radius } => wheel([radius, radius, half_length]),
            Self::Ellipsoid { half_sizes } if is_flat(half_sizes) => wheel(half_sizes),
            Self::Ellipsoid { half_sizes } | Self::Box { half_sizes } => bars(half_sizes),
            Self::Hull(_) => {
                let [middle, half_sizes] = self.bounding_box();
                let capsules = bars(half_sizes);
                let moved = |end: [f32; 3]| [0, 1, 2].map(|i| middle[i] + end[i]);
                capsules.into_iter().map(|c| Capsule { ends: c.ends.map(moved), ..c }).collect()
            }
        }
    }
}

/// Parallel capsules in a box: along its longest axis, side by side along the next.
fn bars(half_sizes: [f32; 3]) -> Vec<Capsule> {
    let (axes, [length, width, radius]) = by_size(half_sizes);
    let count = (width / radius).ceil().clamp(1.0, MOST_BESIDE);
    let capsule = |index: f32| {
        let aside = if count > 1.0 { 2.0 * index / (count - 1.0) - 1.0 } else { 0.0 };
        let end = |sign: f32| placed(axes, [sign * (length - radius), (width - radius) * aside]);
        Capsule { ends: [end(-1.0), end(1.0)], radius }
    };
    (0..count as u32).map(|index| capsule(index as f32)).collect()
}

/// A ring of capsules in a disc, and one across it, which shows how it turns.
fn wheel(half_sizes: [f32; 3]) -> Vec<Capsule> {
    let (axes, [length, width, radius]) = by_size(half_sizes);
    let at = |[x, y]: [f32; 2]| placed(axes, [(length - radius) * x, (width - radius) * y]);
    let corners = OCTAGON.iter().zip(OCTAGON.iter().cycle().skip(1));
    let ring = corners.map(|(from, to)| [at(*from), at(*to)]);
    let across = [at([-1.0, 0.0]), at([1.0, 0.0])];
    ring.chain([across]).map(|ends| Capsule { ends, radius }).collect()
}

/// Whether the shortest half size is less than half of the others.
fn is_flat(half_sizes: [f32; 3]) -> bool {
    let (_, [_, width, height]) = by_size(half_sizes);
    2.0 * height < width
}

/// The axes from the longest to the shortest, and the half sizes along them.
fn by_size(half_sizes: [f32; 3]) -> ([usize; 3], [f32; 3]) {
    let mut axes = [0, 1, 2];
    axes.sort_by(|a, b| half_sizes[*b].total_cmp(&half_sizes[*a]));
    (axes, axes.map(|axis| half_sizes[axis]))
}

/// The point with these coordinates along the first two of the axes.
fn placed(axes: [usize; 3], coordinates: [f32; 2]) -> [f32; 3] {
    let mut point = [0.0; 3];
    (point[axes[0]], point[axes[1]]) = (coordinates[0], coordinates[1]);
    point
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
        let half = FRAC_1_SQRT_2;
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

    /// Whether `is_inside` holds for the absolute coordinates of each end of a capsule and its radius.
    fn all_ends(shape: Shape, is_inside: impl Fn([f32; 3], f32) -> bool) -> bool {
        let capsules = shape.capsules();
        let mut ends =
            capsules.iter().flat_map(|capsule| capsule.ends.map(|end| (end, capsule.radius)));
        ends.all(|(end, radius)| is_inside(end.map(f32::abs), radius))
    }

    #[test]
    fn a_wheel_and_a_table_are_drawn_within_their_surfaces() {
        let wheel = Shape::Cylinder { half_length: 0.02, radius: 0.1 };
        assert_eq!(wheel.capsules().len(), 9);
        assert!(all_ends(wheel, |[x, y, z], radius| {
            (x * x + y * y).sqrt() + radius < 0.1001 && z + radius < 0.0201
        }));
        let table = Shape::Box { half_sizes: [0.5, 0.4, 0.02] };
        assert_eq!(table.capsules().len(), MOST_BESIDE as usize);
        assert!(all_ends(table, |[x, y, z], radius| {
            x + radius < 0.5001 && y + radius < 0.4001 && z + radius < 0.0201
        }));
    }

    #[test]
    fn a_quarter_turn_about_y_rotates_z_to_x() {
        let half = FRAC_1_SQRT_2;
        let turned = rotated([0.0, half, 0.0, half], [0.0, 0.0, 1.0]);
        let error = turned.iter().zip([1.0, 0.0, 0.0]).map(|(a, b)| (a - b).abs()).sum::<f32>();
        assert!(error < 1e-6, "{turned:?}");
    }
}
