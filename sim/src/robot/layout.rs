//! Positions of a robot's coordinates and velocities in its multibody.

mod inverses;

use std::collections::BTreeSet;

use rapier3d::dynamics::{Multibody, MultibodyJoint};
use rapier3d::math::Rotation;
use rapier3d::prelude::*;

use super::assemble::ball_rotation;
use super::blueprint::{Blueprint, FreeJoint, Hinge, HingeAxis, JointPlan, LinkPlan, Motion};
use super::frame::rotation_vector;

/// Largest speed in a state, m/s or rad/s: ten times the speeds that the robots reach.
pub(super) const FASTEST: f32 = 1e3;
/// Largest distance from the origin, m, where f32 resolves 8 mm. Also the bound of a planar root's rotation, rad.
const FARTHEST: f32 = 1e5;
/// Largest violation of a hinge's limits in a state, rad or m.
const LIMIT_SLACK: f32 = 3.0;

/// Wider ranges of hinges suggest degrees that were read as radians.
const WIDEST_RAD: f32 = 4.0 * std::f32::consts::PI;

/// Names of the parts of a quaternion among the coordinates.
pub(super) const QUATERNION: [&str; 4] = ["qw", "qx", "qy", "qz"];
/// Names of the parts of an angular velocity.
pub(super) const TURNING: [&str; 3] = ["wx", "wy", "wz"];

/// Layout of a robot's coordinates. The order is the model's, that of the bodies.
pub(crate) struct Layout {
    pub(crate) multibody: MultibodyIndex,
    /// Joints, one per link of the blueprint.
    pub(crate) joints: Vec<JointMap>,
    /// Hinges in the order of their links, then the three rotations of each ball joint.
    pub(crate) hinges: Vec<HingeMap>,
    /// Ball joints in the order of their links.
    pub(crate) balls: Vec<BallMap>,
    /// Mean inverse mass of each link's mass centre over three directions, in the rest pose, 1/kg: MuJoCo's
    /// `body_invweight0`.
    pub(crate) inverse_masses: Vec<f32>,
    /// For each shape, the same of its body's mass centre and, with torques, of its rotation, 1/(kg m^2).
    pub(crate) shape_inverses: Vec<[f64; 2]>,
    pub(crate) coordinate_names: Vec<String>,
    pub(crate) velocity_names: Vec<String>,
    pub(crate) coordinate_bounds: Vec<[f32; 2]>,
    pub(crate) reference: Vec<f32>,
    pub(crate) rest: Vec<f32>,
    /// For each tendon, its inverse inertia in the rest pose, 1/kg or 1/(kg m^2): MuJoCo's `tendon_invweight0`.
    pub(crate) tendon_inverses: Vec<f64>,
    /// For each connection, the sums of the mean inverse masses of the mass centres of its bodies, 1/kg, and of their inverse
    /// inertias, 1/(kg m^2), in the rest pose.
    pub(crate) connection_inverses: Vec<[f64; 2]>,
    /// Free joints with dry friction.
    pub(crate) free_frictions: Vec<FreeFriction>,
    /// Rotations of the free joints.
    pub(crate) orientations: Vec<Orientation>,
    /// Index of the robot's root among all links.
    pub(crate) root: usize,
}

/// A unit quaternion (w x y z) among the coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Orientation {
    /// Its first coordinate.
    pub(crate) coordinate: usize,
    /// The first of the three angular velocities, in the axes of the world.
    pub(crate) velocity: usize,
}

impl Orientation {
    /// The rotation at these coordinates `[nq]`.
    pub(crate) fn rotation(self, coordinates: &[f32]) -> Rotation {
        rotation_at(coordinates, self.coordinate)
    }
}

/// The rotation of the quaternion (w x y z) from this coordinate on.
fn rotation_at(coordinates: &[f32], first: usize) -> Rotation {
    let [w, x, y, z] = std::array::from_fn(|k| coordinates[first + k]);
    Rotation::from_xyzw(x, y, z, w)
}

/// Joint of a link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JointMap {
    pub(crate) body: RigidBodyHandle,
    /// The link's index in the multibody.
    pub(crate) link: usize,
    /// First row of the joint's velocities in the multibody.
    pub(crate) dof: usize,
    /// First coordinate in a state.
    pub(crate) coordinate: usize,
    /// First velocity in a state.
    pub(crate) velocity: usize,
    pub(crate) kind: MapKind,
}

/// Coordinates of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum MapKind {
    /// x, z, rotation about y.
    Planar,
    /// None.
    Fixed,
    /// Position and quaternion (w x y z); linear and angular velocities, both in world axes. The link is the multibody's
    /// root.
    Free,
    /// As `Free`, with a joint between a fixed root and the link.
    Floating,
    /// One coordinate: the joint's coordinate `axis`, times `sign`.
    Hinge { axis: usize, sign: f32 },
    /// Quaternion (w x y z); angular velocities about the axes of the link.
    Ball,
}

impl MapKind {
    /// Number of velocities, and their sign in the multibody.
    pub(crate) fn speeds(self) -> (usize, f32) {
        match self {
            Self::Fixed => (0, 1.0),
            Self::Hinge { sign, .. } => (1, sign),
            Self::Planar | Self::Ball => (3, 1.0),
            Self::Free | Self::Floating => (6, 1.0),
        }
    }
}

/// A ball joint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BallMap {
    /// Index of the first of its three rotations in [`Layout::hinges`].
    pub(crate) first: usize,
    /// First coordinate of its quaternion (w x y z).
    pub(crate) coordinate: usize,
    /// Largest angle from the rest pose, if it is limited, rad.
    pub(crate) largest: Option<f32>,
}

/// A hinge.
#[derive(Clone, Debug)]
pub(crate) struct HingeMap {
    pub(crate) plan: Hinge,
    /// The link's index in the multibody.
    pub(crate) link: usize,
    /// Row of the hinge's velocity in the multibody.
    pub(crate) dof: usize,
    /// Axis among the joint's six coordinates.
    pub(crate) axis: usize,
    /// MuJoCo's `dof_invweight0`, 1/(kg m^2): [`Self::axis_inverse_inertia`], of a ball joint's axis the mean of its three, and of a
    /// slide near the world the inverse mass of its body without `armature`.
    pub(crate) inverse_inertia: f32,
    /// Inverse inertia of this axis with all other joints free, in the rest pose, 1/(kg m^2).
    pub(crate) axis_inverse_inertia: f32,
}

/// Dry friction of a free joint.
#[derive(Clone, Debug)]
pub(crate) struct FreeFriction {
    pub(crate) plan: FreeJoint,
    /// Index of the link among all links.
    pub(crate) link: usize,
    /// First row of its velocities in the multibody.
    pub(crate) dof: usize,
    /// Mean inverse mass and inertia over three directions, in the rest pose, 1/kg and 1/(kg m^2).
    pub(crate) inverses: [f64; 2],
}

impl HingeMap {
    /// A hinge whose inertia is not known yet.
    fn new(plan: Hinge, link: usize, dof: usize, axis: usize) -> Self {
        Self { plan, link, dof, axis, inverse_inertia: 0.0, axis_inverse_inertia: 0.0 }
    }

    /// Units of its coordinate and of its torque; a slide has a force.
    pub(crate) fn units(&self) -> [&'static str; 2] {
        match self.plan.motion {
            Motion::Translation => ["m", "N"],
            Motion::Rotation | Motion::Ball => ["rad", "N m"],
        }
    }

    /// Whether its range suggests degrees that were read as radians.
    pub(crate) fn has_range_in_degrees(&self) -> bool {
        let is_wide = |[low, high]: [f32; 2]| high - low > WIDEST_RAD;
        self.plan.motion == Motion::Rotation && self.plan.range.is_some_and(is_wide)
    }

    /// Its position, m or rad; of a ball joint the part of the rotation vector.
    pub(crate) fn position(&self, joint: &MultibodyJoint) -> f32 {
        match self.plan.motion {
            Motion::Ball => rotation_vector(ball_rotation(&joint.data))[self.axis - 3] as f32,
            Motion::Rotation | Motion::Translation => {
                self.plan.axis.sign * joint.coords()[self.axis]
            }
        }
    }
}

impl Layout {
    /// The robot in a copy of its template.
    pub(crate) fn robot_in<'a>(&self, joints: &'a MultibodyJointSet) -> &'a Multibody {
        joints.get_multibody(self.multibody).expect("the template holds the robot")
    }

    /// The robot in a copy of its template, to be changed.
    pub(crate) fn robot_in_mut<'a>(&self, joints: &'a mut MultibodyJointSet) -> &'a mut Multibody {
        joints.get_multibody_mut(self.multibody).expect("the template holds the robot")
    }

    /// Joint of the robot's root.
    pub(crate) fn root_joint(&self) -> &JointMap {
        &self.joints[self.root]
    }

    /// Refuses two coordinates or two velocities of the same name.
    pub(super) fn check_names(&self) -> Result<(), String> {
        let kinds = [("coordinates", &self.coordinate_names), ("velocities", &self.velocity_names)];
        for (kind, all) in kinds {
            let mut names = BTreeSet::new();
            if let Some(name) = all.iter().find(|name| !names.insert(*name)) {
                return Err(format!(
                    "two {kind} have the name `{name}`, which follows from those of joints and bodies; rename one"
                ));
            }
        }
        Ok(())
    }

    /// First coordinates of all unit quaternions.
    pub(crate) fn quaternions(&self) -> impl Iterator<Item = usize> {
        let balls = self.balls.iter().map(|ball| ball.coordinate);
        self.orientations.iter().map(|own| own.coordinate).chain(balls)
    }

    /// Position of the hinge with this index at these coordinates `[nq]`, m or rad.
    pub(crate) fn hinge_position(&self, hinge: usize, coordinates: &[f32]) -> f32 {
        let ball = self.balls.iter().find(|ball| (ball.first..ball.first + 3).contains(&hinge));
        let Some(ball) = ball else { return coordinates[self.hinge_coordinate(hinge)] };
        rotation_vector(rotation_at(coordinates, ball.coordinate))[hinge - ball.first] as f32
    }

    /// First coordinate in a state of the hinge with this index.
    pub(crate) fn hinge_coordinate(&self, hinge: usize) -> usize {
        let hinges = self.joints.iter().filter(|joint| matches!(joint.kind, MapKind::Hinge { .. }));
        let found = hinges.map(|joint| joint.coordinate).nth(hinge);
        found.expect("hinges have the indices of the layout")
    }

    pub(super) fn new(
        blueprint: &Blueprint,
        world: &PhysicsWorld,
        handles: &[RigidBodyHandle],
    ) -> Result<Self, String> {
        let lost = || "the robot is not a multibody".to_owned();
        let joints = &world.multibody_joints;
        let multibody = joints.rigid_body_link(handles[0]).ok_or_else(lost)?.multibody;
        let mut layout = Self::empty(multibody, blueprint.root());
        let robot = joints.get_multibody(multibody).ok_or_else(lost)?;
        for (plan, &body) in blueprint.links.iter().zip(handles) {
            let link = joints.rigid_body_link(body).ok_or_else(lost)?.id;
            let dof = robot.link(link).ok_or_else(lost)?.assembly_id();
            layout.add_joint(plan, body, link, dof);
        }
        for (index, plan) in blueprint.links.iter().enumerate() {
            if let Some(ball) = plan.ball() {
                layout.add_ball(ball, layout.joints[index]);
            }
        }
        Ok(layout)
    }

    fn add_ball(&mut self, plan: &Hinge, JointMap { link, dof, coordinate, .. }: JointMap) {
        let (first, largest) = (self.hinges.len(), plan.range.map(|[_, largest]| largest));
        self.balls.push(BallMap { first, coordinate, largest });
        for free in 0..3 {
            let axis = HingeAxis { free, sign: 1.0, frame: Rotation::IDENTITY };
            let plan = Hinge { axis, range: None, ..plan.clone() };
            let (dof, axis) = (dof + free, 3 + free);
            self.hinges.push(HingeMap::new(plan, link, dof, axis));
        }
    }

    fn empty(multibody: MultibodyIndex, root: usize) -> Self {
        Self {
            multibody,
            joints: Vec::new(),
            hinges: Vec::new(),
            balls: Vec::new(),
            inverse_masses: Vec::new(),
            shape_inverses: Vec::new(),
            coordinate_names: Vec::new(),
            velocity_names: Vec::new(),
            coordinate_bounds: Vec::new(),
            reference: Vec::new(),
            rest: Vec::new(),
            tendon_inverses: Vec::new(),
            connection_inverses: Vec::new(),
            free_frictions: Vec::new(),
            orientations: Vec::new(),
            root,
        }
    }

    fn add_joint(&mut self, plan: &LinkPlan, body: RigidBodyHandle, link: usize, dof: usize) {
        let (coordinate, velocity) = (self.coordinate_names.len(), self.velocity_names.len());
        let kind = match &plan.joint {
            JointPlan::Planar(planar) => {
                for (name, reference) in planar.names.iter().zip(planar.reference) {
                    self.add_number(name.clone(), [-FARTHEST, FARTHEST], reference, 0.0);
                    self.velocity_names.push(name.clone());
                }
                MapKind::Planar
            }
            JointPlan::Fixed => MapKind::Fixed,
            JointPlan::Free(joint) => {
                self.add_free(&joint.name, plan);
                MapKind::Free
            }
            JointPlan::Floating(joint) => {
                self.add_free(&joint.name, plan);
                MapKind::Floating
            }
            JointPlan::Hinge(hinge) => {
                let [low, high] = hinge.range.unwrap_or([-FARTHEST, FARTHEST]);
                let bounds = [low - LIMIT_SLACK, high + LIMIT_SLACK];
                self.add_number(hinge.name.clone(), bounds, hinge.reference, 0.0);
                self.velocity_names.push(hinge.name.clone());
                let axis = match hinge.motion {
                    Motion::Rotation | Motion::Ball => 3 + hinge.axis.free,
                    Motion::Translation => hinge.axis.free,
                };
                let plan = hinge.clone();
                self.hinges.push(HingeMap::new(plan, link, dof, axis));
                MapKind::Hinge { axis, sign: hinge.axis.sign }
            }
            JointPlan::Ball(ball) => {
                self.add_quaternion(&ball.name, Rotation::IDENTITY);
                self.velocity_names.extend(TURNING.map(|axis| format!("{}.{axis}", ball.name)));
                MapKind::Ball
            }
        };
        self.joints.push(JointMap { body, link, dof, coordinate, velocity, kind });
    }

    fn add_free(&mut self, name: &str, plan: &LinkPlan) {
        let position = plan.rest.translation.to_array();
        for (axis, rest) in ["x", "y", "z"].iter().zip(position) {
            self.add_number(format!("{name}.{axis}"), [-FARTHEST, FARTHEST], 0.0, rest);
        }
        let (coordinate, velocity) = (self.coordinate_names.len(), self.velocity_names.len() + 3);
        self.orientations.push(Orientation { coordinate, velocity });
        self.add_quaternion(name, plan.rest.rotation);
        for axis in ["x", "y", "z"].into_iter().chain(TURNING) {
            self.velocity_names.push(format!("{name}.{axis}"));
        }
    }

    fn add_quaternion(&mut self, name: &str, rest: Rotation) {
        let [x, y, z, w] = rest.to_array();
        for (axis, rest) in QUATERNION.iter().zip([w, x, y, z]) {
            self.add_number(format!("{name}.{axis}"), [-1.001, 1.001], 0.0, rest);
        }
    }

    fn add_number(&mut self, name: String, bounds: [f32; 2], reference: f32, rest: f32) {
        self.coordinate_names.push(name);
        self.coordinate_bounds.push(bounds);
        self.reference.push(reference);
        self.rest.push(rest);
    }
}
