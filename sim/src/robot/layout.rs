//! Positions of a robot's coordinates and velocities in its multibody.

use std::collections::BTreeSet;

use rapier3d::dynamics::Multibody;
use rapier3d::math::Rotation;
use rapier3d::prelude::*;

use super::blueprint::{Blueprint, FreeJoint, Hinge, JointPlan, LinkPlan, Motion};
use super::coupling::ConnectedPoint;

/// Largest speed in a state, m/s or rad/s: ten times the speeds that the robots reach.
pub(super) const FASTEST: f32 = 1e3;
/// Largest distance from the origin, m, where f32 resolves 8 mm. Also the bound of a planar root's rotation, rad.
const FARTHEST: f32 = 1e5;
/// Largest violation of a hinge's limits in a state, rad or m.
const LIMIT_SLACK: f32 = 3.0;

/// Layout of a robot's coordinates. The order is the model's, that of the bodies.
pub(crate) struct Layout {
    pub(crate) multibody: MultibodyIndex,
    /// Joints, one per link of the blueprint.
    pub(crate) joints: Vec<JointMap>,
    /// Hinges in the order of their links.
    pub(crate) hinges: Vec<HingeMap>,
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
    /// For each connection, the sum of the mean inverse masses of the mass centres of its bodies, in the rest pose, 1/kg.
    pub(crate) connection_inverses: Vec<f64>,
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
        let [w, x, y, z] = std::array::from_fn(|k| coordinates[self.coordinate + k]);
        Rotation::from_xyzw(x, y, z, w)
    }
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
    /// Inverse inertia with all other joints free, in the rest pose, 1/(kg m^2): MuJoCo's `dof_invweight0`.
    pub(crate) inverse_inertia: f32,
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
    /// Units of its coordinate and of its torque; a slide has a force.
    pub(crate) fn units(&self) -> [&'static str; 2] {
        match self.plan.motion {
            Motion::Translation => ["m", "N"],
            Motion::Rotation => ["rad", "N m"],
        }
    }
}

impl Layout {
    /// Joint of the robot's root.
    pub(crate) fn root_joint(&self) -> &JointMap {
        &self.joints[self.root]
    }

    /// Refuses two coordinates of the same name.
    pub(super) fn check_names(&self) -> Result<(), String> {
        let mut names = BTreeSet::new();
        match self.coordinate_names.iter().find(|name| !names.insert(*name)) {
            None => Ok(()),
            Some(name) => Err(format!(
                "two coordinates have the name `{name}`, which follows from those of joints and bodies; rename one"
            )),
        }
    }

    /// First coordinate in a state of the hinge with this index.
    pub(crate) fn hinge_coordinate(&self, hinge: usize) -> usize {
        let hinges = self.joints.iter().filter(|joint| matches!(joint.kind, MapKind::Hinge { .. }));
        let found = hinges.map(|joint| joint.coordinate).nth(hinge);
        found.expect("hinges have the indices of the layout")
    }

    /// Computes inverse masses and inertias in the current pose of `robot`.
    pub(super) fn set_inverse_masses(
        &mut self,
        blueprint: &Blueprint,
        robot: &mut Multibody,
        bodies: &RigidBodySet,
    ) {
        let inverse_inertias = robot.dof_inverse_inertia(bodies);
        for hinge in &mut self.hinges {
            hinge.inverse_inertia = inverse_inertias[hinge.dof];
        }
        for (index, (plan, joint)) in blueprint.links.iter().zip(&self.joints).enumerate() {
            if let JointPlan::Free(free) | JointPlan::Floating(free) = &plan.joint
                && free.friction > 0.0
            {
                let mean = |first: usize| inverse_inertias.rows(joint.dof + first, 3).mean();
                let inverses = [0, 3].map(|first| f64::from(mean(first)));
                let (link, dof) = (index, joint.dof);
                let plan = free.clone();
                self.free_frictions.push(FreeFriction { plan, link, dof, inverses });
            }
        }
        for tendon in &blueprint.tendons {
            let mut force = 0.0 * robot.generalized_velocity().clone_owned();
            for (hinge, factor) in tendon.moved.0.iter() {
                let hinge = &self.hinges[*hinge];
                force[hinge.dof] += factor * hinge.plan.axis.sign;
            }
            let mut acceleration = force.clone();
            robot.inv_augmented_mass().solve_mut(&mut acceleration);
            self.tendon_inverses.push(f64::from(force.dot(&acceleration)));
        }
        let inverse_mass = |joint: &JointMap| {
            let jacobian = robot.body_jacobian(joint.link);
            let along = |row: usize| {
                let force = jacobian.row(row).transpose();
                let mut acceleration = force.clone();
                robot.inv_augmented_mass().solve_mut(&mut acceleration);
                force.dot(&acceleration)
            };
            (0..3).map(along).sum::<f32>() / 3.0
        };
        self.inverse_masses = self.joints.iter().map(inverse_mass).collect();
        for connection in &blueprint.connections {
            let inverse = |end: &ConnectedPoint| {
                let (plan, joint) = (&blueprint.links[end.link?], &self.joints[end.link?]);
                let link = robot.link(joint.link).expect("the layout is this robot's");
                let turn = link.local_to_world().rotation;
                let arm = turn * (end.mass_centre - plan.mass.local_com);
                Some(shape_inverse(robot, joint.link, arm)[0])
            };
            let sum = connection.ends.iter().filter_map(inverse).sum();
            self.connection_inverses.push(sum);
        }
        for (plan, joint) in blueprint.links.iter().zip(&self.joints) {
            let link = robot.link(joint.link).expect("the layout is this robot's");
            let turn = link.local_to_world().rotation;
            for shape in &plan.shapes {
                let arm = turn * (shape.mass_centre - plan.mass.local_com);
                self.shape_inverses.push(shape_inverse(robot, joint.link, arm));
            }
        }
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
        Ok(layout)
    }

    fn empty(multibody: MultibodyIndex, root: usize) -> Self {
        Self {
            multibody,
            joints: Vec::new(),
            hinges: Vec::new(),
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
                    Motion::Rotation => 3 + hinge.axis.free,
                    Motion::Translation => hinge.axis.free,
                };
                let plan = hinge.clone();
                self.hinges.push(HingeMap { plan, link, dof, axis, inverse_inertia: 0.0 });
                MapKind::Hinge { axis, sign: hinge.axis.sign }
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
        let [x, y, z, w] = plan.rest.rotation.to_array();
        for (axis, rest) in ["qw", "qx", "qy", "qz"].iter().zip([w, x, y, z]) {
            self.add_number(format!("{name}.{axis}"), [-1.001, 1.001], 0.0, rest);
        }
        for axis in ["x", "y", "z", "wx", "wy", "wz"] {
            self.velocity_names.push(format!("{name}.{axis}"));
        }
    }

    fn add_number(&mut self, name: String, bounds: [f32; 2], reference: f32, rest: f32) {
        self.coordinate_names.push(name);
        self.coordinate_bounds.push(bounds);
        self.reference.push(reference);
        self.rest.push(rest);
    }
}

/// Mean inverse mass and inertia of a point of a link, `arm` from the link's mass centre, over three directions.
fn shape_inverse(robot: &Multibody, link: usize, arm: Vector) -> [f64; 2] {
    let jacobian = robot.body_jacobian(link);
    let response = |force: Vector, torque: Vector| {
        let parts = force.to_array().into_iter().chain(torque.to_array());
        let rows = parts.enumerate().map(|(row, part)| jacobian.row(row).transpose() * part);
        let pull = rows.reduce(|sum, part| sum + part).expect("a wrench has six numbers");
        let mut acceleration = pull.clone();
        robot.inv_augmented_mass().solve_mut(&mut acceleration);
        f64::from(pull.dot(&acceleration))
    };
    let axes = [Vector::X, Vector::Y, Vector::Z];
    let moved = axes.map(|axis| response(axis, arm.cross(axis)));
    let turned = axes.map(|axis| response(Vector::ZERO, axis));
    [moved, turned].map(|numbers| numbers.iter().sum::<f64>() / 3.0)
}
