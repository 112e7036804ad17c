//! Description of a robot's world, independent of file formats: links, joints, motors, floor.

use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::MassProperties;

use crate::scene::Shape;

/// Description of a robot and its floor.
#[derive(Debug)]
pub(crate) struct Blueprint {
    /// Seconds of one physics step.
    pub(crate) timestep_secs: f64,
    /// Gravity in the world, m/s^2.
    pub(crate) gravity: Vector,
    /// The floor.
    pub(crate) floor: Floor,
    /// Links, parents before children. The first is the root.
    pub(crate) links: Vec<LinkPlan>,
    /// Motors in the order of the model's actuators.
    pub(crate) motors: Vec<MotorPlan>,
    /// Names of the model's bodies in its order, the world first. Bodies without a joint are part of a link.
    pub(crate) bodies: Vec<String>,
}

/// A half-space below the plane z = 0 of its pose.
#[derive(Debug)]
pub(crate) struct Floor {
    pub(crate) pose: Pose,
    pub(crate) friction: f32,
}

/// A link. Bodies without a joint are merged into the link of their parent.
#[derive(Debug)]
pub(crate) struct LinkPlan {
    pub(crate) name: String,
    /// Index of the parent link; `None` for the root.
    pub(crate) parent: Option<usize>,
    /// Rest pose in the frame of the parent link, or in the world for the root.
    pub(crate) rest: Pose,
    pub(crate) joint: JointPlan,
    pub(crate) mass: MassProperties,
    pub(crate) shapes: Vec<ShapePlan>,
}

/// A collision shape in its link's frame.
#[derive(Debug)]
pub(crate) struct ShapePlan {
    pub(crate) shape: Shape,
    pub(crate) pose: Pose,
    pub(crate) friction: f32,
    /// Index of its body in the model.
    pub(crate) body: usize,
}

/// Motion of a link relative to its parent.
#[derive(Debug)]
pub(crate) enum JointPlan {
    /// Translation along x and z and rotation about y, relative to the world.
    Planar(Planar),
    /// All six degrees of freedom, relative to the world; the value is the joint's name.
    Free(String),
    /// One rotation relative to the parent link.
    Hinge(Hinge),
}

/// Joint names of the planar root (x, z, rotation about y) and offsets to the model's own coordinates.
#[derive(Debug)]
pub(crate) struct Planar {
    pub(crate) names: [String; 3],
    pub(crate) reference: [f32; 3],
}

/// A hinge with its passive terms.
#[derive(Debug)]
pub(crate) struct Hinge {
    pub(crate) name: String,
    /// Position in the frame of the child link, m.
    pub(crate) anchor: Vector,
    pub(crate) axis: HingeAxis,
    /// rad.
    pub(crate) range: Option<[f32; 2]>,
    /// N m / rad.
    pub(crate) stiffness: f32,
    /// Rest angle of the spring, rad.
    pub(crate) spring_rest: f32,
    /// N m s / rad.
    pub(crate) damping: f32,
    /// kg m^2.
    pub(crate) armature: f32,
}

/// Axis of a hinge, as an axis of the joint's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HingeAxis {
    /// 0, 1 or 2 for x, y or z of the joint's frame.
    pub(crate) free: usize,
    /// -1 if the model's axis points in the opposite direction.
    pub(crate) sign: f32,
    /// Orientation of the joint's frame in both links.
    pub(crate) frame: Rotation,
}

impl HingeAxis {
    /// Frame for a hinge axis. An axis of the link keeps the frame unrotated, because a rotated frame causes round-off
    /// in tangents along which a planar robot cannot move, and this reduces its friction. For other axes, the frame's x
    /// axis is rotated to them.
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

/// A motor: torque = gear x control.
#[derive(Debug)]
pub(crate) struct MotorPlan {
    /// The hinge it drives.
    pub(crate) joint: String,
    /// N m per unit of control.
    pub(crate) gear: f32,
    /// Range of the control.
    pub(crate) range: [f32; 2],
}
