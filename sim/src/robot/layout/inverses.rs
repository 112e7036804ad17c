//! Inverse masses and inertias of a robot in its rest pose: MuJoCo's `invweight0` of bodies, freedoms and tendons.

use rapier3d::dynamics::Multibody;
use rapier3d::prelude::*;

use super::super::blueprint::{Blueprint, JointPlan, LinkPlan};
use super::super::coupling::ConnectedFrame;
use super::{FreeFriction, JointMap, Layout};

impl Layout {
    /// Computes inverse masses and inertias in the current pose of `robot`.
    pub(in super::super) fn set_inverse_masses(
        &mut self,
        blueprint: &Blueprint,
        robot: &mut Multibody,
        bodies: &RigidBodySet,
    ) {
        self.set_joint_inverses(blueprint, robot, bodies);
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
        let joints = &self.joints;
        let of_body = |link: usize, mass_centre: Vector| {
            let (plan, joint) = (&blueprint.links[link], &joints[link]);
            if plan.is_slider {
                return [f64::from(plan.mass.inv_mass), 0.0];
            }
            let link = robot.link(joint.link).expect("the layout is this robot's");
            let turn = link.local_to_world().rotation;
            shape_inverse(robot, joint.link, turn * (mass_centre - plan.mass.local_com))
        };
        for connection in &blueprint.connections {
            let inverse = |end: &ConnectedFrame| Some(of_body(end.link?, end.mass_centre));
            let inverses = connection.ends.iter().filter_map(inverse);
            let sum = inverses.fold([0.0; 2], |sum, own| [sum[0] + own[0], sum[1] + own[1]]);
            self.connection_inverses.push(sum);
        }
        for (link, plan) in blueprint.links.iter().enumerate() {
            let inverses = plan.shapes.iter().map(|shape| of_body(link, shape.mass_centre));
            self.shape_inverses.extend(inverses);
        }
    }

    /// Computes those of the joints, and what follows from them of their springs and dry friction.
    fn set_joint_inverses(
        &mut self,
        blueprint: &Blueprint,
        robot: &mut Multibody,
        bodies: &RigidBodySet,
    ) {
        let inverse_inertias = robot.dof_inverse_inertia(bodies);
        for hinge in &mut self.hinges {
            hinge.inverse_inertia = inverse_inertias[hinge.dof];
            hinge.axis_inverse_inertia = hinge.inverse_inertia;
        }
        self.set_sliders(blueprint);
        for ball in &self.balls {
            let rotations = &mut self.hinges[ball.first..ball.first + 3];
            let mean = inverse_inertias.rows(rotations[0].dof, 3).mean();
            rotations.iter_mut().for_each(|rotation| rotation.inverse_inertia = mean);
        }
        for hinge in &mut self.hinges {
            if let Some([time_constant, ratio]) = hinge.plan.spring_damper {
                let rate = 1.0 / (time_constant * ratio);
                hinge.plan.stiffness = rate * rate / hinge.inverse_inertia;
                hinge.plan.damping = 2.0 / (time_constant * hinge.inverse_inertia);
            }
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
    }

    /// Of slides near the world MuJoCo takes the inverse mass of the body, which leaves `armature` out. All but the last link of a
    /// body have no mass.
    fn set_sliders(&mut self, blueprint: &Blueprint) {
        for slider in blueprint.links.iter().enumerate().filter(|(_, plan)| plan.is_slider) {
            let (mut link, LinkPlan { mass, .. }) = slider;
            loop {
                let joint = self.joints[link].link;
                let slide = self.hinges.iter_mut().find(|hinge| hinge.link == joint);
                slide.into_iter().for_each(|slide| slide.inverse_inertia = mass.inv_mass);
                let above = blueprint.links[link].parent;
                let Some(above) =
                    above.filter(|above| blueprint.links[*above].mass.inv_mass == 0.0)
                else {
                    break;
                };
                link = above;
            }
        }
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
