//! MuJoCo's equations of motion for the engine's multibody: accelerations with the forces of contacts, joint limits and
//! dry friction, which are solved together.
//!
//! The engine holds the positions of the joints and finds the points in which two shapes touch; it makes no step of its own.
//! A constraint of a length with position `r` and speed `v`,
//! negative for a violation, has the reference acceleration `a_ref = -b v - k d(r) r` and, at the acceleration `a`, the
//! force `(a_ref - a) / R` with `R = (1 - d(r)) / d(r) A`; `A` is its inverse mass in the rest pose.
//! [`Softness`](crate::robot::Softness) holds `k`, `b` and `d`. The step is MuJoCo's semi-implicit Euler step: new
//! velocities from the accelerations, with implicit damping, then new positions from these velocities; or its step of Runge
//! and Kutta.
//!
//! No number is kept between steps, so a rebuilt world continues as the uninterrupted one.

mod contact;
mod contacts;
mod convex;
mod couplings;
mod gyroscopic;
mod matrix;
mod motion;
mod near;
mod pair;
mod points;
mod problem;
mod rows;
mod runge_kutta;
mod segments;

use rapier3d::dynamics::Multibody;
use rapier3d::glamx::DVec3;
use rapier3d::math::Vector;
use rapier3d::prelude::PhysicsWorld;

use super::HingeDrives;
use crate::robot::{FreeFriction, HingeMap, ImplicitForces, Integration, Layout, Robot, unit};
use contacts::Touching;
use gyroscopic::LoneLink;
use matrix::{Factor, dot};
use motion::{Motion, move_joint};
use problem::{ConstraintProblem, Kind};
use runge_kutta::RungeKutta;

/// The constraints of one robot, and memory for a step.
pub(crate) struct Constraints {
    integration: Integration,
    implicit: ImplicitForces,
    step_secs: f64,
    touching: Touching,
    /// Links whose gyroscopic forces are implicit.
    lone: Vec<LoneLink>,
    start: Motion,
    problem: ConstraintProblem,
    /// Mass matrix plus the damping in a step.
    implicit_mass: Factor,
    /// Accelerations, then the change of the velocities in the step.
    change: Vec<f64>,
    /// Velocities at the end of the step.
    end: Vec<f64>,
    stages: RungeKutta,
    /// Sum of the normal impulses in the last step, N s.
    normal_impulse: f64,
}

impl Constraints {
    /// Constraints of a robot at rest, for physics steps of `step_secs`.
    pub(crate) fn new(robot: &Robot, step_secs: f32) -> Self {
        let implicit = robot.blueprint.implicit;
        Self {
            integration: robot.blueprint.integration,
            implicit,
            step_secs: f64::from(step_secs),
            touching: Touching::new(robot),
            lone: if implicit == ImplicitForces::All { LoneLink::all(robot) } else { Vec::new() },
            start: Motion::default(),
            problem: ConstraintProblem::default(),
            implicit_mass: Factor::default(),
            change: Vec::new(),
            end: Vec::new(),
            stages: RungeKutta::default(),
            normal_impulse: 0.0,
        }
    }

    /// Sum of the normal impulses in the last step, N s.
    pub(crate) fn normal_impulse(&self) -> f32 {
        self.normal_impulse as f32
    }

    /// Depths, m, in which shapes are in each other, with the shapes as `Touching` counts them.
    pub(crate) fn depths(
        &mut self,
        robot: &Robot,
        multibody: &Multibody,
        physics: &PhysicsWorld,
    ) -> Vec<([usize; 2], f32)> {
        self.start.read(robot, multibody, physics, std::iter::empty());
        self.touching.depths(&robot.blueprint, physics, &self.start)
    }

    /// Sets the friction of all contacts to this multiple of the model's.
    pub(crate) fn set_friction(&mut self, factor: f32) {
        self.touching.friction = f64::from(factor);
    }

    /// Makes a step with the torques of `drives`. Returns whether the motion is finite, and contacts are not too many.
    pub(crate) fn step(
        &mut self,
        robot: &Robot,
        drives: &mut HingeDrives,
        physics: &mut PhysicsWorld,
    ) -> bool {
        if !self.accelerate(robot, drives, physics) {
            return false;
        }
        self.normal_impulse = self.step_secs * self.touching.normal_force(&self.problem.forces);
        if self.integration == Integration::RungeKutta {
            return self.finish_runge_kutta(robot, drives, physics);
        }
        drives.advance(1.0, None);
        let (mut end, start) = (std::mem::take(&mut self.end), std::mem::take(&mut self.start));
        end.clone_from(&start.speeds);
        matrix::add_scaled(&mut end, self.step_secs, &self.change);
        let is_finite = self.go(robot, physics, &start, [&end, &end]);
        (self.end, self.start) = (end, start);
        is_finite
    }

    /// Computes the accelerations, with the forces that MuJoCo's integrator takes implicitly. Returns
    /// whether a step may have so many contacts.
    fn accelerate(
        &mut self,
        robot: &Robot,
        drives: &mut HingeDrives,
        physics: &mut PhysicsWorld,
    ) -> bool {
        let layout = &robot.layout;
        let multibody = layout.robot_in(&physics.multibody_joints);
        self.start.read(robot, multibody, physics, drives.thrusts());
        self.weigh(layout, drives, multibody);
        self.count_forces_on_links(layout, drives, physics.gravity.as_dvec3());
        if !self.constrain(robot, physics) {
            return false;
        }
        if self.problem.has_constraints() {
            self.problem.solve();
        }
        self.problem.total(&mut self.change);
        let known = (self.implicit_mass.matrix.as_slice(), self.change.as_slice());
        let lone = self.lone.iter();
        let lone: Vec<(usize, [f64; 6])> = lone
            .filter_map(|link| link.accelerations(&self.start, known, self.step_secs))
            .collect();
        self.implicit_mass.factorise(self.change.len());
        self.implicit_mass.solve(&mut self.change);
        for (dof, accelerations) in lone {
            self.change[dof..][..accelerations.len()].copy_from_slice(&accelerations);
        }
        true
    }

    /// Computes the mass matrix and the forces without constraints.
    fn weigh(&mut self, layout: &Layout, drives: &HingeDrives, multibody: &Multibody) {
        let size = self.start.speeds.len();
        self.problem.clear(size);
        self.start.write(multibody, &mut self.problem);
        self.change.clear();
        self.change.resize(size, 0.0);
        let implicit = &mut self.implicit_mass.matrix;
        implicit.clone_from(&self.problem.mass);
        for (index, (damping, speed)) in
            multibody.damping().iter().zip(&self.start.speeds).enumerate()
        {
            let damping = f64::from(*damping);
            if self.implicit != ImplicitForces::Nothing {
                implicit[index * size + index] += self.step_secs * damping;
            }
            self.problem.pull[index] -= damping * speed;
        }
        if self.implicit == ImplicitForces::All {
            self.add_shared_dampings(layout, drives);
        }
        for (hinge, torque) in layout.hinges.iter().zip(drives.torques()) {
            self.problem.pull[hinge.dof] += f64::from(hinge.plan.axis.sign * torque);
        }
    }

    /// Counts forces on links as torques of motors: those of actuators on sites, and gravity compensation where the model says
    /// so.
    fn count_forces_on_links(&mut self, layout: &Layout, drives: &mut HingeDrives, gravity: DVec3) {
        for (index, hinge) in layout.hinges.iter().enumerate() {
            if !drives.counts_forces_on_links(hinge) {
                continue;
            }
            let (dof, sign) = (hinge.dof, f64::from(hinge.plan.axis.sign));
            let gravity = if hinge.plan.compensates_gravity { gravity } else { DVec3::ZERO };
            let force = (sign * self.start.actuation(dof, gravity)) as f32;
            let [change, damping] = drives.count(index, force, hinge.plan.torque_range);
            self.problem.pull[dof] += sign * f64::from(change);
            if self.implicit != ImplicitForces::Nothing {
                let diagonal = dof * self.start.speeds.len() + dof;
                self.implicit_mass.matrix[diagonal] -= self.step_secs * f64::from(damping);
            }
        }
    }

    /// Adds to the implicit mass what dampings of several hinges do to each other, as in MuJoCo only along a chain of links.
    fn add_shared_dampings(&mut self, layout: &Layout, drives: &HingeDrives) {
        let size = self.start.speeds.len();
        for (moved, damping) in drives.shared_dampings() {
            let levers = moved.0.iter().map(|(index, factor)| {
                let hinge = &layout.hinges[*index];
                (hinge.dof, f64::from(hinge.plan.axis.sign * factor))
            });
            let change = self.step_secs * f64::from(damping);
            for (row, lever) in levers.clone() {
                let others = levers.clone().filter(|(column, _)| *column <= row);
                for (column, other) in
                    others.filter(|(column, _)| self.start.share_link(row, *column))
                {
                    self.implicit_mass.matrix[row * size + column] += change * lever * other;
                }
            }
        }
    }

    /// Adds all constraints. Returns whether a step may have so many contacts.
    fn constrain(&mut self, robot: &Robot, physics: &PhysicsWorld) -> bool {
        let layout = &robot.layout;
        for (hinge, position) in layout.hinges.iter().zip(&self.start.hinges) {
            add_limit(&mut self.problem, &self.start.speeds, hinge, *position);
            add_dry_friction(&mut self.problem, &self.start.speeds, hinge);
        }
        for ball in &layout.balls {
            let first = &layout.hinges[ball.first];
            let turn = [0, 1, 2].map(|k| self.start.hinges[ball.first + k]);
            let (Some(largest), Some(axis)) = (ball.largest, unit(turn)) else { continue };
            let distance = f64::from(largest - first.plan.margin) - dot(&turn, &axis);
            if distance < 0.0 {
                let inward = axis.map(|part| -part);
                add_end(&mut self.problem, &self.start.speeds, (first, &inward), distance);
            }
        }
        couplings::add(&mut self.problem, &self.start, robot);
        for free in &layout.free_frictions {
            add_free_friction(&mut self.problem, &self.start, free);
        }
        self.touching.add(&robot.blueprint, physics, &self.start, &mut self.problem)
    }

    /// Moves the robot from `start` for a step with the velocities `moving`, and sets its velocities. Returns whether they
    /// are finite.
    fn go(
        &self,
        robot: &Robot,
        physics: &mut PhysicsWorld,
        start: &Motion,
        [moving, speeds]: [&[f64]; 2],
    ) -> bool {
        let layout = &robot.layout;
        let multibody = layout.robot_in_mut(&mut physics.multibody_joints);
        let write = |multibody: &mut Multibody, speeds: &[f64]| {
            let mut to = multibody.generalized_velocity_mut();
            to.iter_mut().zip(speeds).for_each(|(to, speed)| *to = *speed as f32);
            to.iter().all(|speed| speed.is_finite())
        };
        if !write(multibody, moving) {
            return false;
        }
        let joints = layout.joints.iter().zip(&robot.blueprint.links);
        for (joint, start) in joints.zip(&start.links) {
            move_joint(multibody, joint, start, self.step_secs as f32);
        }
        if !write(multibody, speeds) {
            return false;
        }
        multibody.forward_kinematics(&physics.bodies, false);
        multibody.links().all(|link| link.local_to_world().translation.is_finite())
    }
}

/// Adds the ends of a hinge's range that it has passed.
fn add_limit(problem: &mut ConstraintProblem, speeds: &[f64], hinge: &HingeMap, position: f64) {
    let Some(range) = hinge.plan.range else { return };
    let margin = f64::from(hinge.plan.margin);
    let [low, high] = range.map(f64::from);
    let (low, high) = (low + margin, high - margin);
    for (inward, distance) in [(1.0, position - low), (-1.0, high - position)] {
        if distance >= 0.0 {
            continue;
        }
        let direction = inward * f64::from(hinge.plan.axis.sign);
        add_end(problem, speeds, (hinge, &[direction]), distance);
    }
}

/// Adds an end of a range that was passed by `-distance`. `inward` points back into it, along the velocities from that of
/// `hinge` on.
fn add_end(
    problem: &mut ConstraintProblem,
    speeds: &[f64],
    (hinge, inward): (&HingeMap, &[f64]),
    distance: f64,
) {
    let dofs = hinge.dof..hinge.dof + inward.len();
    problem.add_row()[dofs.clone()].copy_from_slice(inward);
    let compliance = f64::from(hinge.plan.limit.compliance(-distance as f32));
    let aim = hinge.plan.limit.reference_acceleration(Some(distance), dot(inward, &speeds[dofs]));
    problem.set_row(aim, compliance * f64::from(hinge.inverse_inertia));
    problem.close(Kind::Push);
}

fn add_dry_friction(problem: &mut ConstraintProblem, speeds: &[f64], hinge: &HingeMap) {
    if hinge.plan.friction <= 0.0 {
        return;
    }
    let softness = &hinge.plan.friction_softness;
    problem.add_row()[hinge.dof] = 1.0;
    let compliance = f64::from(softness.compliance(0.0));
    let aim = softness.reference_acceleration(None, speeds[hinge.dof]);
    problem.set_row(aim, compliance * f64::from(hinge.inverse_inertia));
    problem.close(Kind::Bounded(f64::from(hinge.plan.friction)));
}

/// Adds the dry friction of a free joint: along the axes of the world, and about those of the link.
fn add_free_friction(problem: &mut ConstraintProblem, start: &Motion, free: &FreeFriction) {
    let softness = &free.plan.friction_softness;
    let turn = start.links[free.link].pose.rotation;
    let axes = [Vector::X, Vector::Y, Vector::Z];
    for (first, axes, inverse) in [
        (free.dof, axes, free.inverses[0]),
        (free.dof + 3, axes.map(|axis| turn * axis), free.inverses[1]),
    ] {
        for axis in axes {
            let row = &mut problem.add_row()[first..first + 3];
            row.iter_mut().zip(axis.to_array()).for_each(|(to, part)| *to = f64::from(part));
            let speeds = row.iter().zip(&start.speeds[first..]);
            let speed = speeds.map(|(part, speed)| part * speed).sum();
            let aim = softness.reference_acceleration(None, speed);
            problem.set_row(aim, f64::from(softness.compliance(0.0)) * inverse);
            problem.close(Kind::Bounded(f64::from(free.plan.friction)));
        }
    }
}
