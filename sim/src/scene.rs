//! Shapes and poses of a robot's links, for recordings and the live view.

use rapier3d::math::Pose as Transform;
use rapier3d::prelude::SharedShape;

use crate::description::Description;
use crate::error::SimError;
use crate::game;
use crate::robot::{JointPlan, LinkPlan, Robot};

/// Pose of a robot at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// Frames of all links in the world, from the root outwards.
    pub links: Vec<LinkPose>,
    /// All hinges.
    pub joints: Vec<JointPose>,
}

/// A link's frame in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkPose {
    /// Name of the link.
    pub name: String,
    /// Metres.
    pub position: [f32; 3],
    /// Unit quaternion, x y z w.
    pub quaternion: [f32; 4],
}

/// Angle and speed of a hinge.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPose {
    /// Name of the joint.
    pub name: String,
    /// Radians.
    pub position: f32,
    /// Radians per second.
    pub velocity: f32,
}

/// One shape of a link, in the link's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkShape {
    /// Link that the shape is attached to.
    pub link: String,
    /// Form and size.
    pub shape: Shape,
    /// Metres.
    pub position: [f32; 3],
    /// Unit quaternion, x y z w.
    pub quaternion: [f32; 4],
}

/// Form and size of a shape, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
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
}

impl LinkShape {
    /// End points of the shape's axis in the world, metres, for the link pose `link`; equal for a ball.
    #[must_use]
    pub fn ends(&self, link: &LinkPose) -> [[f32; 3]; 2] {
        let axis = rotated(self.quaternion, [0.0, 0.0, 1.0]);
        let half = match self.shape {
            Shape::Capsule { half_length, .. } => half_length,
            Shape::Sphere { .. } => 0.0,
        };
        [-half, half]
            .map(|along| link.in_world([0, 1, 2].map(|i| self.position[i] + along * axis[i])))
    }
}

impl LinkPose {
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

/// Agent that controls the joint of each link, or `None`. The root has no hinge and every other link has exactly one,
/// so links and hinges are in the same order.
#[must_use]
pub fn drivers(description: &Description, pose: &Pose) -> Vec<Option<usize>> {
    let driver = |joint: &str| {
        description.agents.iter().position(|agent| agent.joints.iter().any(|name| name == joint))
    };
    let roots = pose.links.len() - pose.joints.len();
    let hinged = pose.joints.iter().map(|joint| driver(&joint.name));
    std::iter::repeat_n(None, roots).chain(hinged).collect()
}

impl Shape {
    /// Radius, metres.
    #[must_use]
    pub fn radius(self) -> f32 {
        match self {
            Self::Capsule { radius, .. } | Self::Sphere { radius } => radius,
        }
    }

    pub(crate) fn collider(self) -> SharedShape {
        match self {
            Self::Capsule { half_length, radius } => SharedShape::capsule_z(half_length, radius),
            Self::Sphere { radius } => SharedShape::ball(radius),
        }
    }
}

/// Shapes of a task's robot, link by link; empty for a game.
pub fn shapes(task: &str) -> Result<Vec<LinkShape>, SimError> {
    let Some(robot) = robot(task)? else { return Ok(Vec::new()) };
    let links = robot.blueprint().links.iter();
    Ok(links
        .flat_map(|link| {
            link.shapes.iter().map(|plan| {
                let (position, quaternion) = parts(&plan.pose);
                LinkShape { link: link.name.clone(), shape: plan.shape, position, quaternion }
            })
        })
        .collect())
}

/// Positions of a robot's hinges in the frames of their child links, metres, in the order of a pose's joints; empty for
/// a game.
pub fn hinges(task: &str) -> Result<Vec<[f32; 3]>, SimError> {
    let Some(robot) = robot(task)? else { return Ok(Vec::new()) };
    let anchor = |link: &LinkPlan| match &link.joint {
        JointPlan::Hinge(hinge) => Some(hinge.anchor.to_array()),
        _ => None,
    };
    Ok(robot.blueprint().links.iter().filter_map(anchor).collect())
}

/// Robot of a task; `None` for a game.
fn robot(task: &str) -> Result<Option<Robot>, SimError> {
    match task {
        game::cue::NAME => Ok(None),
        task => Robot::of_task(task).map(Some),
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
    fn a_quarter_turn_about_y_rotates_z_to_x() {
        let half = core::f32::consts::FRAC_1_SQRT_2;
        let turned = rotated([0.0, half, 0.0, half], [0.0, 0.0, 1.0]);
        let error = turned.iter().zip([1.0, 0.0, 0.0]).map(|(a, b)| (a - b).abs()).sum::<f32>();
        assert!(error < 1e-6, "{turned:?}");
    }
}
