//! The motion of a robot's links at the start of a step, its mass matrix, and the forces without constraints.

use rapier3d::dynamics::{Multibody, MultibodyJoint, RigidBodySet};
use rapier3d::glamx::{DMat3, DQuat, DVec3};
use rapier3d::math::{Pose, Vector};
use rapier3d::prelude::PhysicsWorld;

use super::super::{floating_at, floating_pose};
use super::problem::ConstraintProblem;
use crate::robot::{
    Blueprint, Fluid, JointMap, JointPlan, Layout, LinkPlan, MapKind, ball_joint, ball_rotation,
    turned,
};

/// The motion at the start of a step. Velocities have the order of the multibody.
#[derive(Default)]
pub(super) struct Motion {
    pub(super) speeds: Vec<f64>,
    /// Links in the order of the blueprint.
    pub(super) links: Vec<LinkMotion>,
    /// Positions of the hinges in the model's direction, m or rad.
    pub(super) hinges: Vec<f64>,
}

/// A link at the start of a step, in the axes of the world.
pub(super) struct LinkMotion {
    pub(super) pose: Pose,
    pub(super) mass_centre: DVec3,
    /// Linear and angular velocity of the mass centre for each velocity.
    pub(super) jacobian: Vec<[f64; 6]>,
    pub(super) joint: MultibodyJoint,
    /// kg and kg m^2; 0 for links without a mass.
    mass: f64,
    /// Mass on which gravity acts, kg.
    weight: f64,
    inertia: DMat3,
    /// Force on the mass centre, N, and torque, N m, from outside.
    pull: [DVec3; 2],
    /// Velocity of the mass centre, m/s, and angular velocity, rad/s.
    pub(super) velocity: [DVec3; 2],
    /// Their rates while all velocities of the joints are constant, m/s^2 and rad/s^2.
    pub(super) rates: [DVec3; 2],
}

impl Motion {
    /// Reads the motion from the multibody.
    pub(super) fn read(
        &mut self,
        blueprint: &Blueprint,
        layout: &Layout,
        multibody: &Multibody,
        physics: &PhysicsWorld,
    ) {
        self.speeds.clear();
        self.speeds.extend(multibody.generalized_velocity().iter().map(|speed| f64::from(*speed)));
        let mut old = std::mem::take(&mut self.links).into_iter();
        for (plan, map) in blueprint.links.iter().zip(&layout.joints) {
            let memory = old.next().map(|link| link.jacobian).unwrap_or_default();
            let mut link = LinkMotion::read(map, multibody, &physics.bodies, memory);
            link.velocity = link.velocity_for(&self.speeds);
            link.pull[0] += link.weight * wide(physics.gravity);
            link.rates = rates(plan, &link, plan.parent.map(|parent| &self.links[parent]));
            self.links.push(link);
        }
        if let Some(fluid) = &blueprint.fluid {
            self.flow(fluid);
        }
        self.hinges.clear();
        self.hinges.extend(layout.hinges.iter().map(|hinge| {
            let link = multibody.link(hinge.link).expect("the layout is this robot's");
            f64::from(hinge.position(link.joint()))
        }));
    }

    /// Adds the forces of a fluid.
    fn flow(&mut self, fluid: &Fluid) {
        let wind = DVec3::from_array(fluid.wind);
        for body in &fluid.boxes {
            let link = &mut self.links[body.link];
            let pose = link.pose * body.pose;
            let axes = DQuat::from_array(pose.rotation.to_array().map(f64::from));
            let arm = wide(pose.translation) - link.mass_centre;
            let [speed, spin] = link.velocity;
            let inside = [speed + spin.cross(arm) - wind, spin]
                .map(|velocity| (axes.inverse() * velocity).to_array());
            let [force, torque] =
                fluid.wrench(body.sizes, inside).map(|part| axes * DVec3::from_array(part));
            link.pull[0] += force;
            link.pull[1] += torque + arm.cross(force);
        }
    }

    /// Writes the mass matrix with armature, and the forces of gravity, of the rotation of the links and from outside.
    pub(super) fn write(&self, multibody: &Multibody, problem: &mut ConstraintProblem) {
        let size = self.speeds.len();
        for link in self.links.iter().filter(|link| link.mass > 0.0) {
            link.add_mass(&mut problem.mass);
            link.add_pull(&mut problem.pull);
        }
        for (index, armature) in multibody.armature().iter().enumerate() {
            problem.mass[index * size + index] += f64::from(*armature);
        }
    }
}

impl LinkMotion {
    /// Reads a link. `jacobian` is memory.
    fn read(
        map: &JointMap,
        multibody: &Multibody,
        bodies: &RigidBodySet,
        mut jacobian: Vec<[f64; 6]>,
    ) -> Self {
        let link = multibody.link(map.link).expect("the layout is this robot's");
        let body = &bodies[map.body];
        let properties = &body.mass_properties().local_mprops;
        let pose = *link.local_to_world();
        let turn = DMat3::from_quat(DQuat::from_array(pose.rotation.to_array().map(f64::from)));
        let axes = properties.reconstruct_inertia_matrix().to_cols_array().map(f64::from);
        let is_massive = properties.inv_mass > 0.0;
        jacobian.clear();
        let columns = multibody.body_jacobian(map.link).column_iter();
        let columns = columns.map(|column| std::array::from_fn(|row| f64::from(column[row])));
        jacobian.extend(columns);
        let mass = if is_massive { f64::from(properties.mass()) } else { 0.0 };
        Self {
            pose,
            mass_centre: wide(pose * properties.local_com),
            jacobian,
            joint: *link.joint(),
            mass,
            weight: mass * f64::from(body.gravity_scale()),
            inertia: turn * DMat3::from_cols_array(&axes) * turn.transpose(),
            pull: [wide(body.user_force()), wide(body.user_torque())],
            velocity: [DVec3::ZERO; 2],
            rates: [DVec3::ZERO; 2],
        }
    }

    /// Acceleration of one of its points while all velocities of the joints are constant, m/s^2.
    pub(super) fn acceleration(&self, point: DVec3) -> DVec3 {
        let (arm, [_, spin], [moving, turning]) =
            (point - self.mass_centre, self.velocity, self.rates);
        moving + turning.cross(arm) + spin.cross(spin.cross(arm))
    }

    fn velocity_for(&self, speeds: &[f64]) -> [DVec3; 2] {
        let mut sum = [0.0; 6];
        for (column, speed) in self.jacobian.iter().zip(speeds) {
            sum.iter_mut().zip(column).for_each(|(sum, part)| *sum += part * speed);
        }
        [DVec3::from_slice(&sum[..3]), DVec3::from_slice(&sum[3..])]
    }

    /// Adds the link's part to the lower half of the mass matrix.
    fn add_mass(&self, matrix: &mut [f64]) {
        let size = self.jacobian.len();
        for (index, column) in self.jacobian.iter().enumerate() {
            if *column == [0.0; 6] {
                continue;
            }
            let push = self.mass * DVec3::from_slice(&column[..3]);
            let twist = self.inertia * DVec3::from_slice(&column[3..]);
            let momentum = [push.x, push.y, push.z, twist.x, twist.y, twist.z];
            for (other, number) in self.jacobian.iter().zip(&mut matrix[index * size..][..=index]) {
                *number += momentum.iter().zip(other).fold(0.0, |sum, (a, b)| sum + a * b);
            }
        }
    }

    /// Adds the force on the link from outside, less what its motion at constant velocities needs.
    fn add_pull(&self, out: &mut [f64]) {
        let [acceleration, turning] = self.rates;
        let spin = self.velocity[1];
        let force = self.pull[0] - self.mass * acceleration;
        let torque = self.pull[1] - self.inertia * turning - spin.cross(self.inertia * spin);
        let wrench = [force.x, force.y, force.z, torque.x, torque.y, torque.z];
        for (number, column) in out.iter_mut().zip(&self.jacobian) {
            *number += column.iter().zip(&wrench).fold(0.0, |sum, (a, b)| sum + a * b);
        }
    }
}

/// Rates of a link's velocity and angular velocity while all velocities of the joints are constant.
fn rates(plan: &LinkPlan, link: &LinkMotion, parent: Option<&LinkMotion>) -> [DVec3; 2] {
    let spin = link.velocity[1];
    let around = |spin: DVec3, arm: DVec3| spin.cross(spin.cross(arm));
    let hinge = match &plan.joint {
        JointPlan::Fixed => return [DVec3::ZERO; 2],
        // A ball joint turns about its anchor as a hinge does: its speeds are about the axes of the link.
        JointPlan::Hinge(hinge) | JointPlan::Ball(hinge) => hinge,
        // The velocities are those of the link's origin.
        JointPlan::Planar(_) | JointPlan::Free(_) | JointPlan::Floating(_) => {
            return [around(spin, link.mass_centre - wide(link.pose.translation)), DVec3::ZERO];
        }
    };
    let still = [DVec3::ZERO; 2];
    let [base, base_turning] = parent.map_or(still, |parent| parent.rates);
    let [base_speed, base_spin] = parent.map_or(still, |parent| parent.velocity);
    let base_centre = parent.map_or(DVec3::ZERO, |parent| parent.mass_centre);
    let on_base = |point: DVec3| {
        let arm = point - base_centre;
        base + base_turning.cross(arm) + around(base_spin, arm)
    };
    let turning = base_turning + base_spin.cross(spin - base_spin);
    if hinge.is_slide() {
        let moved = base_speed + base_spin.cross(link.mass_centre - base_centre);
        let sliding = link.velocity[0] - moved;
        return [on_base(link.mass_centre) + 2.0 * base_spin.cross(sliding), turning];
    }
    let anchor = wide(link.pose * hinge.anchor);
    let arm = link.mass_centre - anchor;
    [on_base(anchor) + turning.cross(arm) + around(spin, arm), turning]
}

/// Moves a joint from its start with the velocities of the multibody.
pub(super) fn move_joint(
    multibody: &mut Multibody,
    (map, plan): (&JointMap, &LinkPlan),
    start: &LinkMotion,
    step_secs: f32,
) {
    let count = match map.kind {
        MapKind::Fixed => return,
        MapKind::Ball => 3,
        MapKind::Hinge { .. } => 1,
        MapKind::Planar => 3,
        MapKind::Free | MapKind::Floating => 6,
    };
    let mut moved = [0.0; 6];
    let speeds = multibody.generalized_velocity();
    for (moved, speed) in moved[..count].iter_mut().zip(speeds.iter().skip(map.dof)) {
        *moved = step_secs * speed;
    }
    let link = multibody.link_mut(map.link).expect("the layout is this robot's");
    if let JointPlan::Ball(ball) = &plan.joint {
        let rotation = turned(ball_rotation(&start.joint.data), [moved[0], moved[1], moved[2]]);
        link.joint = MultibodyJoint::new(ball_joint(plan, ball, rotation), false);
        return;
    }
    link.joint = start.joint;
    link.joint.apply_displacement(&moved[..count]);
    if map.kind == MapKind::Floating {
        // The joint of a rebuilt world has its orientation elsewhere, and would round differently.
        let (position, rotation) = floating_pose(&link.joint);
        link.joint = floating_at(position, rotation);
    }
}

/// A vector in double precision.
pub(super) fn wide(vector: Vector) -> DVec3 {
    DVec3::from_array(vector.to_array().map(f64::from))
}
