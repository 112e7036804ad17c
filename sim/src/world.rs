//! One robot in one rapier world: rebuild, step, read.

mod backdrop;
mod conditions;
mod constraints;
mod contact_law;
mod diagnostics;
mod hinge_drives;

use std::mem;
use std::sync::Arc;

use rapier3d::dynamics::{Multibody, MultibodyJoint};
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::PhysicsWorld;

pub(crate) use conditions::EpisodeConditions;
pub(crate) use constraints::Constraints;
pub(crate) use contact_law::ContactLaw;
pub(crate) use hinge_drives::HingeDrives;

use crate::robot::{
    JointMap, Law, Layout, MapKind, Robot, ball_joint, ball_rotation, empty_world, floating_joint,
};
use crate::scene::{JointPose, LinkPose, parts};

/// What enforces contacts and limits, with its state.
enum Enforcer {
    Constraints(Box<Constraints>),
    Engine(ContactLaw),
}

/// One robot in one world.
///
/// Coordinates and velocities are read from the joints, not from the rigid bodies: rapier updates the bodies before the
/// last substep, not after it.
pub struct World {
    robot: Arc<Robot>,
    physics: PhysicsWorld,
    drives: HingeDrives,
    enforcer: Enforcer,
    /// Physics steps in an environment step.
    substeps: u32,
    /// Sums over the physics steps of the last step of the torques of the motors, N m, in the order of [`HingeDrives`].
    efforts: Vec<f64>,
    /// Differences from the model; `None` for the model itself.
    conditions: Option<EpisodeConditions>,
}

impl World {
    /// The robot in its rest pose, without motion.
    pub fn new(robot: Arc<Robot>) -> Self {
        Self::refined(robot, 1)
    }

    /// As [`Self::new`], with every physics step split into `parts` shorter ones, for higher accuracy.
    pub fn refined(robot: Arc<Robot>, parts: u32) -> Self {
        let physics = empty_world(&robot.blueprint, parts);
        let step_secs = physics.integration_parameters.dt;
        let mut world = Self {
            drives: HingeDrives::new(&robot.blueprint, &robot.layout, step_secs),
            enforcer: match robot.blueprint.law {
                Law::Constraints => {
                    Enforcer::Constraints(Box::new(Constraints::new(&robot, step_secs)))
                }
                Law::Engine { compliance } => {
                    Enforcer::Engine(ContactLaw::new(&robot, compliance, step_secs))
                }
            },
            physics,
            substeps: robot.frame_skip * parts,
            efforts: vec![0.0; robot.layout.hinges.len()],
            conditions: None,
            robot: Arc::clone(&robot),
        };
        world.rebuild(robot.rest(), &vec![0.0; robot.velocity_names().len()]);
        world
    }

    /// The robot of this world.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// As [`Self::rebuild`], but keeps the efforts of the last step.
    pub(crate) fn correct(&mut self, coordinates: &[f32], velocities: &[f32]) {
        let efforts = mem::take(&mut self.efforts);
        self.rebuild(coordinates, velocities);
        self.efforts = efforts;
    }

    /// Discards all history and starts from this motion. All later steps depend only on it and the controls.
    ///
    /// # Panics
    /// If `coordinates` is not `[nq]` or `velocities` is not `[nv]`.
    pub fn rebuild(&mut self, coordinates: &[f32], velocities: &[f32]) {
        assert_eq!(coordinates.len(), self.robot.coordinate_names().len(), "coordinates");
        assert_eq!(velocities.len(), self.robot.velocity_names().len(), "velocities");
        self.start(coordinates, velocities);
        if let Enforcer::Constraints(_) = self.enforcer {
            return;
        }
        // The contact law reads the impulses of the last step. After this trial, which is undone, they are close to those
        // of an uninterrupted world.
        if self.substep() {
            self.write(coordinates, velocities);
            self.drives.activations().for_each(|activation| *activation = 0.0);
        } else {
            // The motion is unstable and rapier has disabled bodies. The next real step must detect this itself.
            self.start(coordinates, velocities);
        }
    }

    /// Sets the activations of the motors that have one, `[m]`, which are 0 after a rebuild.
    pub(crate) fn set_activations(&mut self, activations: &[f32]) {
        let own = self.drives.activations();
        own.zip(activations).for_each(|(own, activation)| *own = *activation);
    }

    /// Writes these activations.
    pub fn activations(&mut self, out: &mut [f32]) {
        out.iter_mut().zip(self.drives.activations()).for_each(|(out, own)| *out = *own);
    }

    /// Runs one environment step with one control per motor. Returns whether the state is still finite.
    pub fn step(&mut self, controls: &[f32]) -> bool {
        self.command(controls);
        self.efforts.fill(0.0);
        (0..self.substeps).all(|_| {
            let is_finite = self.substep();
            let efforts = self.efforts.iter_mut().zip(self.drives.efforts());
            efforts.for_each(|(sum, effort)| *sum += f64::from(effort));
            is_finite
        })
    }

    /// Mean torques of the actuators in the last step, N m, or forces on slides, N, in the order of [`crate::Pose::joints`], then
    /// about the axes of ball joints. 0 before the first step. As MuJoCo's `qfrc_actuator`, without springs and dampers.
    pub fn efforts(&self) -> impl Iterator<Item = f32> {
        self.efforts.iter().map(|sum| (sum / f64::from(self.substeps)) as f32)
    }

    /// Sets the motors' controls, each clamped to its range, for the next physics steps.
    pub fn command(&mut self, controls: &[f32]) {
        for (index, control) in controls.iter().enumerate() {
            self.drives.command(index, *control);
        }
    }

    /// Runs one physics step with the last controls. Returns whether the state is still finite.
    pub fn substep(&mut self) -> bool {
        let layout = &self.robot.layout;
        let robot = layout.robot_in_mut(&mut self.physics.multibody_joints);
        self.drives.apply(robot, &layout.hinges);
        match &mut self.enforcer {
            Enforcer::Engine(contacts) => {
                contacts.observe(&self.robot, robot);
                self.physics.step_with_events(&*contacts, &());
                self.drives.advance(1.0, None);
                let robot = layout.robot_in(&self.physics.multibody_joints);
                self.drives.note(robot, &layout.hinges);
                // The engine disables bodies with non-finite values and reports this only here.
                self.physics.quarantine().is_empty()
            }
            Enforcer::Constraints(constraints) => {
                constraints.step(&self.robot, &mut self.drives, &mut self.physics)
            }
        }
    }

    /// Writes the generalised coordinates `[nq]` relative to the rest pose, m and rad.
    pub fn coordinates(&self, out: &mut [f32]) {
        let multibody = self.multibody();
        for joint in &self.robot.layout.joints {
            read_coordinates(multibody, joint, &mut out[joint.coordinate..]);
        }
    }

    /// Writes the generalised velocities `[nv]`, m/s and rad/s.
    pub fn velocities(&self, out: &mut [f32]) {
        let velocities = self.multibody().generalized_velocity();
        for joint in &self.robot.layout.joints {
            let (count, sign) = joint.kind.speeds();
            for k in 0..count {
                out[joint.velocity + k] = sign * velocities[joint.dof + k];
            }
        }
    }

    /// Frames of all links in the world.
    pub(crate) fn link_poses(&self) -> Vec<LinkPose> {
        let links = self.robot.blueprint.links.iter().zip(&self.robot.layout.joints);
        links
            .map(|(plan, joint)| {
                let (position, quaternion) = parts(&self.frame(joint));
                LinkPose { name: plan.name.clone(), parent: plan.parent, position, quaternion }
            })
            .collect()
    }

    /// Angles, as agents observe them, and speeds of all hinges.
    pub(crate) fn joint_poses(&self) -> Vec<JointPose> {
        let robot = &self.robot;
        let mut coordinates = vec![0.0; robot.coordinate_names().len()];
        let mut velocities = vec![0.0; robot.velocity_names().len()];
        self.coordinates(&mut coordinates);
        self.velocities(&mut velocities);
        let hinges = robot.layout.joints.iter().enumerate();
        hinges
            .filter(|(_, joint)| matches!(joint.kind, MapKind::Hinge { .. }))
            .map(|(link, joint)| JointPose {
                name: robot.coordinate_names()[joint.coordinate].clone(),
                link,
                position: coordinates[joint.coordinate] + robot.reference()[joint.coordinate],
                velocity: velocities[joint.velocity],
            })
            .collect()
    }

    fn start(&mut self, coordinates: &[f32], velocities: &[f32]) {
        self.robot.template.copy_into(&mut self.physics);
        self.drives.clear();
        self.efforts.fill(0.0);
        self.apply_conditions();
        self.write(coordinates, velocities);
    }

    /// Sets all joints and links to this motion, and what the engine's solver reads. The contacts keep their impulses.
    fn write(&mut self, coordinates: &[f32], velocities: &[f32]) {
        for index in 0..self.robot.layout.joints.len() {
            self.write_joint(index, coordinates, velocities);
        }
        let layout = &self.robot.layout;
        let multibody = layout.robot_in_mut(&mut self.physics.multibody_joints);
        multibody.forward_kinematics(&self.physics.bodies, true);
        if let Enforcer::Engine(_) = self.enforcer {
            place(&mut self.physics, layout);
        }
    }

    fn multibody(&self) -> &Multibody {
        self.robot.layout.robot_in(&self.physics.multibody_joints)
    }

    fn frame(&self, joint: &JointMap) -> Pose {
        *self.multibody().link(joint.link).expect("the layout is this robot's").local_to_world()
    }

    /// The template's coordinates are zero, so a displacement from there sets them exactly.
    fn write_joint(&mut self, index: usize, coordinates: &[f32], velocities: &[f32]) {
        let Robot { blueprint, layout, template, .. } = &*self.robot;
        let (plan, joint) = (&blueprint.links[index], &layout.joints[index]);
        let multibody = layout.robot_in_mut(&mut self.physics.multibody_joints);
        let template = layout.robot_in(&template.multibody_joints).link(joint.link);
        let q = &coordinates[joint.coordinate..];
        let link = multibody.link_mut(joint.link).expect("the layout is this robot's");
        link.joint = *template.expect("the layout is this robot's").joint();
        let (count, sign) = joint.kind.speeds();
        match joint.kind {
            MapKind::Fixed => {}
            MapKind::Planar => link.joint.apply_displacement(&q[..3]),
            MapKind::Hinge { .. } => link.joint.apply_displacement(&[sign * q[0]]),
            MapKind::Ball => {
                let rotation = Rotation::from_xyzw(q[1], q[2], q[3], q[0]);
                let data = plan.ball().map(|ball| ball_joint(plan, ball, rotation));
                link.joint.data = data.expect("a map has the kind of its plan");
            }
            MapKind::Floating => {
                let rotation = Rotation::from_xyzw(q[4], q[5], q[6], q[3]);
                link.joint = floating_at([q[0], q[1], q[2]], rotation);
            }
            MapKind::Free => {
                // Not renormalised, because the encoded state must be restored exactly.
                let pose = Pose::from_parts(
                    Vector::new(q[0], q[1], q[2]),
                    Rotation::from_xyzw(q[4], q[5], q[6], q[3]),
                );
                self.physics.bodies[joint.body].set_position(pose, true);
            }
        }
        for k in 0..count {
            multibody.generalized_velocity_mut()[joint.dof + k] =
                sign * velocities[joint.velocity + k];
        }
    }
}

/// Moves bodies and colliders to the poses of a multibody's links. The engine leaves the colliders where they are, and the
/// next step would use the contacts there.
fn place(physics: &mut PhysicsWorld, layout: &Layout) {
    layout.robot_in(&physics.multibody_joints).update_rigid_bodies(&mut physics.bodies, true);
    for (_, collider) in physics.colliders.iter_mut() {
        let parent = collider.parent().and_then(|parent| physics.bodies.get(parent));
        if let (Some(body), Some(inside)) = (parent, collider.position_wrt_parent().copied()) {
            collider.set_position(*body.position() * inside);
        }
    }
}

/// The joint of a floating root. The orientation is a part of the joint's frame, because the joint's own cannot be set.
fn floating_at([x, y, z]: [f32; 3], rotation: Rotation) -> MultibodyJoint {
    let mut joint = MultibodyJoint::new(floating_joint(rotation), false);
    joint.apply_displacement(&[x, y, z, 0.0, 0.0, 0.0]);
    joint
}

/// Position and orientation of a floating root.
fn floating_pose(joint: &MultibodyJoint) -> ([f32; 3], Rotation) {
    let coords = joint.coords();
    let rotation = joint.joint_rot() * joint.data.local_frame2.rotation.inverse();
    ([coords[0], coords[1], coords[2]], rotation)
}

/// Adds zero to turn -0 into 0, as writing the value back would.
fn read_coordinates(multibody: &Multibody, joint: &JointMap, out: &mut [f32]) {
    let link = multibody.link(joint.link).expect("the layout is this robot's");
    let coords = link.joint().coords();
    match joint.kind {
        MapKind::Planar => {
            for (to, axis) in out.iter_mut().zip([0, 2, 4]) {
                *to = coords[axis] + 0.0;
            }
        }
        MapKind::Fixed => {}
        MapKind::Ball => {
            let [x, y, z, w] = ball_rotation(&link.joint().data).to_array();
            out[..4].copy_from_slice(&[w, x, y, z]);
        }
        MapKind::Hinge { axis, sign } => out[0] = sign * coords[axis] + 0.0,
        MapKind::Free | MapKind::Floating => {
            let rotation = match joint.kind {
                MapKind::Floating => floating_pose(link.joint()).1,
                _ => link.joint().joint_rot(),
            };
            let [x, y, z, w] = rotation.to_array();
            out[..7].copy_from_slice(&[coords[0], coords[1], coords[2], w, x, y, z]);
        }
    }
}

#[cfg(test)]
mod tests;
