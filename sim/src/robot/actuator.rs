//! Actuators as they are shown to people: what they act on, their controls, and their largest torques; and their laws.

use proto::{ActivationKind, ActuatorKind, ActuatorSpec};
use rapier3d::glamx::DVec3;

use super::Robot;
use super::blueprint::{MotorPlan, Servo};
use super::layout::BallMap;

/// An actuator of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Actuator<'a> {
    /// Name of the actuator; that of its joint, unless the model states one or the joint has several.
    pub name: &'a str,
    /// Name of the joint, tendon or site that it acts on.
    pub joint: &'a str,
    /// If it acts on a site, the name of the link there.
    pub pushed: Option<&'a str>,
    /// Names of the joints that it moves; none if it acts on a site.
    pub moved: Vec<&'a str>,
    /// Range of its control.
    pub control: [f32; 2],
    /// What limits its torque.
    pub torque: Torque,
    /// Unit of its torque: `N` or `N m`, for a tendon over hinges and slides both.
    pub unit: &'static str,
}

/// Largest torque or force of an actuator, in [`Actuator::unit`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Torque {
    /// Of a motor, whose torque depends on the control only.
    Motor(f32),
    /// Of a servo, whose torque also depends on the joint's position or speed; `None` without a limit.
    Servo(Option<f32>),
}

impl Robot {
    /// Actuators in the model's order.
    pub fn actuators(&self) -> impl Iterator<Item = Actuator<'_>> {
        self.blueprint.motors.iter().map(|motor| {
            let hinges = &self.layout.hinges;
            let only = motor.moved.only_hinge();
            let limit = only.and_then(|hinge| hinges[hinge].plan.torque_range).map(largest);
            let moved = motor.moved.0.iter().map(|(hinge, _)| hinges[*hinge].plan.name.as_str());
            let mut moved: Vec<&str> = moved.collect();
            moved.dedup();
            let torque = match motor.servo {
                Some(servo) if servo.bias[1..] != [0.0; 2] => {
                    let own = servo.range.map(|range| motor.gear.abs() * largest(range));
                    Torque::Servo(own.into_iter().chain(limit).reduce(f32::min))
                }
                _ => {
                    let range = motor.range;
                    let ends = motor.activation.map_or(range, |own| own.inputs(range));
                    let ends = ends.map(|input| motor.torque_of(input).unwrap_or(0.0));
                    Torque::Motor(limit.map_or(largest(ends), |limit| largest(ends).min(limit)))
                }
            };
            let (name, joint) = (&motor.name, &motor.joint);
            let links = &self.blueprint.links;
            let pushed = motor.thrust.map(|thrust| links[thrust.link].name.as_str());
            let unit = self.unit_of(motor);
            Actuator { name, joint, pushed, moved, control: motor.range, torque, unit }
        })
    }

    /// Unit of the torque or force of a motor.
    pub(super) fn unit_of(&self, motor: &MotorPlan) -> &'static str {
        if let Some(thrust) = motor.thrust {
            return if thrust.force == DVec3::ZERO { "N m" } else { "N" };
        }
        let unit = |(hinge, _): &(usize, f32)| self.layout.hinges[*hinge].units()[1];
        let mut units = motor.moved.0.iter().map(unit);
        let first = units.next().unwrap_or("N");
        if units.all(|unit| unit == first) { first } else { "N or N m" }
    }
}

impl Robot {
    /// The law of the actuator with this index in the model.
    pub(crate) fn actuator_spec(&self, index: usize) -> ActuatorSpec {
        let motor = &self.blueprint.motors[index];
        let direct = Servo { gain: 1.0, bias: [0.0; 3], observed_constant: 0.0, range: None };
        let Servo { gain, bias, observed_constant: constant, range } =
            motor.servo.unwrap_or(direct);
        let [_, stiffness, slope] = bias;
        // The difference from 0 is never -0.
        let (kp, kd) = (0.0 - stiffness, 0.0 - slope);
        let kind = if kp == 0.0 && kd == 0.0 {
            ActuatorKind::Motor
        } else if constant == 0.0 && kp != 0.0 && gain == kp {
            ActuatorKind::Position
        } else if constant == 0.0 && kp == 0.0 && gain == kd {
            ActuatorKind::Velocity
        } else {
            ActuatorKind::General
        };
        let joint = motor.moved.only_hinge().filter(|_| motor.tendon.is_none());
        let filter = motor.activation.filter(|own| own.kind != ActivationKind::Integrator);
        ActuatorSpec {
            name: motor.name.clone(),
            joint: motor.joint.clone(),
            kind,
            control_limits: motor.range,
            gear: motor.gear,
            gain,
            constant,
            kp,
            kd,
            force_range: range,
            torque_range: joint.and_then(|hinge| self.layout.hinges[hinge].plan.torque_range),
            activation: motor.activation.map(|own| own.kind),
            time_constant_secs: filter.map(|own| own.time_constant_secs),
            activation_range: motor.activation.and_then(|own| own.range),
            ball_axis: self.ball_axis(motor),
            link: motor.thrust.map(|thrust| self.blueprint.links[thrust.link].name.clone()),
            link_point: motor.thrust.map(|thrust| thrust.point.to_array()),
            link_force: motor.thrust.map(|thrust| thrust.force.as_vec3().to_array()),
            link_torque: motor.thrust.map(|thrust| thrust.torque.as_vec3().to_array()),
        }
    }

    /// Whether all motors act on hinges and slides, directly or by tendons.
    #[must_use]
    pub fn drives_only_joints(&self) -> bool {
        let turns_ball = |(hinge, _): &(usize, f32)| self.layout.hinges[*hinge].plan.turns_ball();
        let is_other =
            |motor: &MotorPlan| motor.thrust.is_some() || motor.moved.0.iter().any(turns_ball);
        !self.blueprint.motors.iter().any(is_other)
    }

    /// The axis by which the gear of a motor on a ball joint is multiplied, in axes of the child.
    fn ball_axis(&self, motor: &MotorPlan) -> Option<[f32; 3]> {
        let (first, _) = motor.moved.0.first().filter(|_| motor.tendon.is_none())?;
        let turned = |ball: &&BallMap| (ball.first..ball.first + 3).contains(first);
        let ball = self.layout.balls.iter().find(turned)?;
        let mut axis = [0.0; 3];
        motor.moved.0.iter().for_each(|(hinge, part)| axis[hinge - ball.first] = *part);
        Some(axis)
    }
}

fn largest([a, b]: [f32; 2]) -> f32 {
    a.abs().max(b.abs())
}

impl MotorPlan {
    /// Torque for a control or activation, without the joint's limit, N m; `None` if it also depends on the robot's motion.
    fn torque_of(&self, input: f32) -> Option<f32> {
        let Some(servo) = self.servo else { return Some(self.gear * input) };
        let [constant, stiffness, slope] = servo.bias;
        let force = servo.gain * input + constant;
        let force = servo.range.map_or(force, |[low, high]| force.clamp(low, high));
        (stiffness == 0.0 && slope == 0.0).then_some(self.gear * force)
    }
}
