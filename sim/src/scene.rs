//! What a recording shows: the links' shapes, and where they are at a moment.

use rapier3d::math::Pose as Transform;
use rapier3d::prelude::SharedShape;

use crate::error::SimError;
use crate::game;
use crate::robot::Robot;
use crate::task;

/// A robot at a moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// Every link's frame in the world, from the root outwards.
    pub links: Vec<LinkPose>,
    /// Every hinge.
    pub joints: Vec<JointPose>,
}

/// A link's frame in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkPose {
    /// The link's name.
    pub name: String,
    /// Metres.
    pub position: [f32; 3],
    /// Unit quaternion, x y z w.
    pub quaternion: [f32; 4],
}

/// A hinge's angle.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPose {
    /// The joint's name.
    pub name: String,
    /// Radians.
    pub position: f32,
    /// Radians per second.
    pub velocity: f32,
}

/// One shape of a link, in the link's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkShape {
    /// The link that carries it.
    pub link: String,
    /// Form and measures.
    pub shape: Shape,
    /// Metres.
    pub position: [f32; 3],
    /// Unit quaternion, x y z w.
    pub quaternion: [f32; 4],
}

/// A form and its measures in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A cylinder along z with two half-spheres on its ends.
    Capsule {
        /// Half the cylinder's length.
        half_length: f32,
        /// The cylinder's and the half-spheres' radius.
        radius: f32,
    },
    /// A ball.
    Sphere {
        /// Its radius.
        radius: f32,
    },
}

impl Shape {
    pub(crate) fn collider(self) -> SharedShape {
        match self {
            Self::Capsule { half_length, radius } => SharedShape::capsule_z(half_length, radius),
            Self::Sphere { radius } => SharedShape::ball(radius),
        }
    }
}

/// The shapes of a task's robot, link by link; none of a game.
pub fn shapes(task: &str) -> Result<Vec<LinkShape>, SimError> {
    if task == game::cue::NAME {
        return Ok(Vec::new());
    }
    let robot = Robot::build(task::find(task)?.robot)?;
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

/// A transform as position and quaternion (x y z w).
pub(crate) fn parts(pose: &Transform) -> ([f32; 3], [f32; 4]) {
    (pose.translation.to_array(), pose.rotation.to_array())
}
