//! What a robot's world is built from, free of any file format: links, joints, motors, floor.

use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::MassProperties;

use crate::scene::Shape;

/// A robot's plan.
#[derive(Debug)]
pub(crate) struct Blueprint {
    /// Seconds of one physics step.
    pub(crate) timestep_secs: f64,
    /// Gravity in the world, m/s^2.
    pub(crate) gravity: Vector,
    /// The ground.
    pub(crate) floor: Floor,
    /// Links, parents before children; the first is the root.
    pub(crate) links: Vec<LinkPlan>,
    /// Motors in the order of the model's actuators.
    pub(crate) motors: Vec<MotorPlan>,
    /// The model's bodies in its order, the world first; those without a joint are part of a link.
    pub(crate) bodies: Vec<String>,
}

/// A half-space whose free side is its z.
#[derive(Debug)]
pub(crate) struct Floor {
    pub(crate) pose: Pose,
    pub(crate) friction: f32,
}

/// One link. Bodies without a joint are merged into the link that carries them.
#[derive(Debug)]
pub(crate) struct LinkPlan {
    pub(crate) name: String,
    /// Index of the parent link; the root has none.
    pub(crate) parent: Option<usize>,
    /// Rest pose in the parent link's frame; the root's in the world.
    pub(crate) rest: Pose,
    pub(crate) joint: JointPlan,
    pub(crate) mass: MassProperties,
    pub(crate) shapes: Vec<ShapePlan>,
}

/// One collision shape in its link's frame.
#[derive(Debug)]
pub(crate) struct ShapePlan {
    pub(crate) shape: Shape,
    pub(crate) pose: Pose,
    pub(crate) friction: f32,
    /// Index of the model's body that it belongs to.
    pub(crate) body: usize,
}

/// How a link moves against its parent.
#[derive(Debug)]
pub(crate) enum JointPlan {
    /// Slide along x, slide along z, turn about y, against the world.
    Planar(Planar),
    /// All six, against the world.
    Free(String),
    /// One turn against the parent link.
    Hinge(Hinge),
}

/// The planar root's joint names (x, z, turn about y) and what 0 stands for in the model's coordinates.
#[derive(Debug)]
pub(crate) struct Planar {
    pub(crate) names: [String; 3],
    pub(crate) reference: [f32; 3],
}

/// A hinge with its passive terms.
#[derive(Debug)]
pub(crate) struct Hinge {
    pub(crate) name: String,
    /// In the child link's frame, m.
    pub(crate) anchor: Vector,
    pub(crate) axis: HingeAxis,
    /// rad.
    pub(crate) range: Option<[f32; 2]>,
    /// N m / rad.
    pub(crate) stiffness: f32,
    /// Where the spring rests, rad.
    pub(crate) spring_rest: f32,
    /// N m s / rad.
    pub(crate) damping: f32,
    /// kg m^2.
    pub(crate) armature: f32,
}

/// A hinge's axis as the solver takes it: one of the joint frame's own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HingeAxis {
    /// 0, 1 or 2 for x, y or z of the joint's frame.
    pub(crate) free: usize,
    /// -1 where the model's axis points against that frame's axis.
    pub(crate) sign: f32,
    /// The joint's frame in both links.
    pub(crate) frame: Rotation,
}

impl HingeAxis {
    /// Axes along a link axis keep the frame unrotated: rotated frames leave round-off in the tangents that a
    /// planar robot cannot move along, and that eats its friction. Other axes turn the frame's x to them.
    pub(crate) fn along(axis: Vector) -> Self {
        let axis = axis.normalize();
        let units = axis.to_array();
        match units.iter().position(|component| component.abs() == 1.0) {
            Some(free) => Self { free, sign: units[free], frame: Rotation::IDENTITY },
            None => {
                Self { free: 0, sign: 1.0, frame: Rotation::from_rotation_arc(Vector::X, axis) }
            }
        }
    }
}

/// One motor: torque = gear x control.
#[derive(Debug)]
pub(crate) struct MotorPlan {
    /// The hinge it drives.
    pub(crate) joint: String,
    /// N m per unit of control.
    pub(crate) gear: f32,
    /// Range of the control.
    pub(crate) range: [f32; 2],
}
