//! What turns the hinges: motors, springs, and limits after MuJoCo's law.
//!
//! A violated limit is MuJoCo's soft constraint `f = (a_ref - a) / R`, which pushes only. Its `a` is the acceleration that
//! the force itself makes, so the law is an armature of `1 / R` and a torque of `a_ref / R`. Whether it pushes depends
//! on the acceleration without it, which is predicted from the last step's.

use rapier3d::dynamics::Multibody;

use crate::robot::{HingeMap, Layout, RobotRow, Softness, Spring};

/// Stiffness through which torques enter a hinge, N m / rad: what a torque loses when the hinge turns by a radian.
const WEAK_SPRING: f32 = 0.01;

/// The hinges' torques and what a step leaves for the next.
pub(crate) struct HingeDrives {
    softness: Softness,
    spring: Spring,
    step_secs: f32,
    /// In the order of [`Layout::hinges`].
    drives: Vec<Drive>,
}

/// One hinge's. Angles, speeds and torques count as the model's do.
#[derive(Clone, Copy, Debug, Default)]
struct Drive {
    /// Of the motor under the last command, N m.
    torque: f32,
    /// The motor's torque in the last step, N m.
    last_torque: f32,
    /// Speed at the start of the step, rad/s.
    speed: f32,
    /// Acceleration of the last step without the limit's torque, rad/s^2.
    free_acceleration: f32,
    /// The limit in this step.
    limit: Limit,
}

/// A limit's part of a step; all zero while it does not push.
#[derive(Clone, Copy, Debug, Default)]
struct Limit {
    /// `1 / R`, kg m^2.
    armature: f32,
    /// `a_ref` towards larger angles, rad/s^2.
    reference: f32,
}

impl HingeDrives {
    /// Drives at rest, for physics steps of `step_secs`.
    pub(crate) fn new(row: &RobotRow, layout: &Layout, step_secs: f32) -> Self {
        Self {
            softness: row.limits,
            spring: row.limits.spring(row.integration, step_secs),
            step_secs,
            drives: vec![Drive::default(); layout.hinges.len()],
        }
    }

    /// Forgets torques and past steps.
    pub(crate) fn clear(&mut self) {
        self.drives.fill(Drive::default());
    }

    /// Sets a motor's torque, N m.
    pub(crate) fn command(&mut self, hinge: usize, torque: f32) {
        self.drives[hinge].torque = torque;
    }

    /// Puts the torques of the coming physics step into the robot. The engine's spring pulls with `-k (q - rest)`; a weak
    /// one that rests `torque / k` away adds a torque without a constraint.
    pub(crate) fn apply(&mut self, robot: &mut Multibody, hinges: &[HingeMap]) {
        for (index, hinge) in hinges.iter().enumerate() {
            let at = robot.link(hinge.link).expect("the layout is this robot's").joint().coords();
            let at = at[hinge.axis];
            let angle = hinge.sign * at;
            let speed = hinge.sign * robot.generalized_velocity()[hinge.dof];
            let limit = self.limit(index, hinge, angle, speed);
            let drive = &mut self.drives[index];
            drive.speed = speed;
            drive.limit = limit;
            drive.last_torque = drive.torque;
            let spring = -hinge.stiffness * (angle - hinge.spring_rest);
            let torque = drive.torque + spring + limit.armature * limit.reference;
            robot.armature_mut()[hinge.dof] = hinge.armature + limit.armature;
            let link = robot.link_mut(hinge.link).expect("the layout is this robot's");
            let rest = at + hinge.sign * torque / WEAK_SPRING;
            link.joint.set_spring(hinge.axis, WEAK_SPRING, rest);
        }
    }

    /// Notes the accelerations of the physics step that has ended.
    pub(crate) fn note(&mut self, robot: &Multibody, hinges: &[HingeMap]) {
        let speeds = robot.generalized_velocity();
        for (drive, hinge) in self.drives.iter_mut().zip(hinges) {
            let acceleration = (hinge.sign * speeds[hinge.dof] - drive.speed) / self.step_secs;
            let push = drive.limit.armature * (drive.limit.reference - acceleration);
            drive.free_acceleration = acceleration - hinge.inverse_inertia * push;
        }
    }

    /// The limit that the angle violates, if it would push.
    fn limit(&self, index: usize, hinge: &HingeMap, angle: f32, speed: f32) -> Limit {
        let Some([low, high]) = hinge.range else { return Limit::default() };
        // Towards the range is positive, and a violation negative.
        let (position, inward) = if angle < low {
            (angle - low, 1.0)
        } else if angle > high {
            (high - angle, -1.0)
        } else {
            return Limit::default();
        };
        let drive = &self.drives[index];
        let speed = inward * speed;
        let reference = (self.spring.next_speed(speed, position) - speed) / self.step_secs;
        let changed = hinge.inverse_inertia * (drive.torque - drive.last_torque);
        if reference <= inward * (drive.free_acceleration + changed) {
            return Limit::default();
        }
        let compliance = self.softness.compliance(-position) * hinge.inverse_inertia;
        Limit { armature: 1.0 / compliance, reference: inward * reference }
    }
}
