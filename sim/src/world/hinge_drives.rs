//! Hinge torques: motors, springs, and joint limits by MuJoCo's law.
//!
//! A violated limit is MuJoCo's soft constraint `f = (a_ref - a) / R`, which acts only towards the range. `a` includes
//! the effect of the force itself, so the constraint is an armature of `1 / R` and a torque of `a_ref / R`. Whether it
//! is active depends on the acceleration without it, which is predicted from the last step.

use rapier3d::dynamics::Multibody;

use crate::robot::{HingeMap, Layout, RobotRow, Softness, Spring};

/// Stiffness of the spring that applies torques to a hinge, N m / rad: the change of the torque per radian.
const WEAK_SPRING: f32 = 0.01;

/// Torques of the hinges and their state between steps.
pub(crate) struct HingeDrives {
    softness: Softness,
    spring: Spring,
    step_secs: f32,
    /// Drives in the order of [`Layout::hinges`].
    drives: Vec<Drive>,
}

/// Drive of one hinge. Angles, speeds and torques have the model's sign.
#[derive(Clone, Copy, Debug, Default)]
struct Drive {
    /// Torque of the motor for the last control, N m.
    torque: f32,
    /// Torque of the motor in the last step, N m.
    last_torque: f32,
    /// Speed at the start of the step, rad/s.
    speed: f32,
    /// Acceleration in the last step without the limit's torque, rad/s^2.
    free_acceleration: f32,
    /// Limit in this step.
    limit: Limit,
}

/// Effect of a limit in a step; all zero while it is inactive.
#[derive(Clone, Copy, Debug, Default)]
struct Limit {
    /// `1 / R`, kg m^2.
    armature: f32,
    /// `a_ref`, positive towards larger angles, rad/s^2.
    reference: f32,
}

impl HingeDrives {
    /// Creates drives at rest, for physics steps of `step_secs`.
    pub(crate) fn new(row: &RobotRow, layout: &Layout, step_secs: f32) -> Self {
        Self {
            softness: row.limits,
            spring: row.limits.spring(row.integration, step_secs),
            step_secs,
            drives: vec![Drive::default(); layout.hinges.len()],
        }
    }

    /// Resets torques and past steps.
    pub(crate) fn clear(&mut self) {
        self.drives.fill(Drive::default());
    }

    /// Sets the torque of a motor, N m.
    pub(crate) fn command(&mut self, hinge: usize, torque: f32) {
        self.drives[hinge].torque = torque;
    }

    /// Applies the torques of the next physics step to the robot. The engine's spring has the torque `-k (q - rest)`. A
    /// weak spring with its rest at distance `torque / k` therefore adds a torque without a constraint.
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

    /// Stores the accelerations of the last physics step.
    pub(crate) fn note(&mut self, robot: &Multibody, hinges: &[HingeMap]) {
        let speeds = robot.generalized_velocity();
        for (drive, hinge) in self.drives.iter_mut().zip(hinges) {
            let acceleration = (hinge.sign * speeds[hinge.dof] - drive.speed) / self.step_secs;
            let push = drive.limit.armature * (drive.limit.reference - acceleration);
            drive.free_acceleration = acceleration - hinge.inverse_inertia * push;
        }
    }

    /// Limit that the angle violates; zero if it is inactive.
    fn limit(&self, index: usize, hinge: &HingeMap, angle: f32, speed: f32) -> Limit {
        let Some([low, high]) = hinge.range else { return Limit::default() };
        // Positive towards the range; a violation is negative.
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
