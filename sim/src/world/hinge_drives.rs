//! Hinge torques: motors, springs, and joint limits by MuJoCo's law.
//!
//! A violated limit is MuJoCo's soft constraint `f = (a_ref - a) / R`, which acts only towards the range. `a` includes
//! the effect of the force itself, so the constraint is an armature of `1 / R` and a torque of `a_ref / R`. Whether it
//! is active depends on the acceleration without it, which is predicted from the last step.

use rapier3d::dynamics::Multibody;

use crate::robot::{
    Blueprint, Combination, HingeMap, ImplicitForces, Law, Layout, MotorPlan, Robot, Spring,
    TendonPlan, Thrust,
};

/// Stiffness of the spring that applies torques to a hinge, N m / rad: the change of the torque per radian.
const WEAK_SPRING: f32 = 0.01;

/// Torques of the hinges and their state between steps. Slides have forces instead, in newtons.
pub(crate) struct HingeDrives {
    /// Springs of the limits, in the order of [`Layout::hinges`]; `None` if [`Constraints`](super::Constraints) enforces
    /// them.
    springs: Vec<Option<Spring>>,
    step_secs: f32,
    /// In the order of [`Blueprint::motors`].
    motors: Vec<Motor>,
    /// Damping of the hinges, N m s / rad, in the order of [`Layout::hinges`].
    dampings: Vec<f32>,
    /// Tendons with a spring or a damper.
    tendons: Vec<TendonPlan>,
    /// Drives in the order of [`Layout::hinges`].
    drives: Vec<Drive>,
    /// Whether a motor acts on a site.
    has_thrusts: bool,
    /// Lower bound of a hinge's damping by motors that a step takes implicitly, N m s / rad.
    least_damping: f32,
}

/// A motor with its state.
#[derive(Clone, Debug)]
struct Motor {
    plan: MotorPlan,
    /// Clamped.
    control: f32,
    /// 0 without one.
    activation: f32,
    /// Its rate, 1/s.
    rate: f32,
    /// Activation at the start of the step.
    start: f32,
    /// Mean rate of the stages of the step until now, 1/s.
    mean_rate: f32,
    /// Position of a whole turn, if it is a servo of the position of a ball joint.
    turn: Option<f32>,
    /// Whether its range limits its force.
    is_limited: bool,
    /// Force, or torque, that it exerts on its site, N or N m; 0 without one.
    thrust: f32,
}

/// Drive of one hinge. Angles, speeds and torques have the model's sign.
#[derive(Clone, Copy, Debug, Default)]
struct Drive {
    /// Torque of the motors, N m.
    effort: f32,
    /// Torque of motors and tendons, N m.
    torque: f32,
    /// The same in the last step, N m.
    last_torque: f32,
    /// Part of the motors' torque that the engine adds as damping, N m s / rad.
    damping: f32,
    /// Angle at the start of the step, rad.
    angle: f32,
    /// Torque of motors, spring and limit without the damping that the step adds, N m.
    applied: f32,
    /// Speed at the start of the step, rad/s.
    speed: f32,
    /// Acceleration in the last step without the limit's torque, rad/s^2.
    free_acceleration: f32,
    /// Limit in this step.
    limit: Limit,
}

/// The position of a whole turn of a ball joint, if the actuator is a servo of it.
fn whole_turn(plan: &MotorPlan, layout: &Layout) -> Option<f32> {
    let servo = plan.servo?;
    let (first, _) = plan.moved.0.first()?;
    let is_on_ball = plan.tendon.is_none() && layout.hinges[*first].plan.turns_ball();
    let is_servo = servo.gain != 0.0 && servo.gain == -servo.bias[1];
    let gear: f32 = plan.moved.0.iter().map(|(_, factor)| factor * factor).sum();
    (is_on_ball && is_servo).then(|| std::f32::consts::TAU * plan.gear.abs() * gear.sqrt())
}

/// Effect of a limit in a step; all zero while it is inactive.
#[derive(Clone, Copy, Debug, Default)]
struct Limit {
    /// `1 / R`, kg m^2.
    armature: f32,
    /// `a_ref`, positive towards larger angles, rad/s^2.
    reference: f32,
}

impl Motor {
    /// What its gain multiplies in a stage.
    fn input(&mut self, step_secs: f32) -> f32 {
        let Some(own) = &self.plan.activation else { return self.control };
        self.rate = own.rate(self.activation, self.control);
        if own.is_early { own.next(self.activation, self.rate, step_secs) } else { self.activation }
    }
}

impl HingeDrives {
    /// Creates drives at rest, for physics steps of `step_secs`.
    pub(crate) fn new(blueprint: &Blueprint, layout: &Layout, step_secs: f32) -> Self {
        let spring = |hinge: &HingeMap| match blueprint.law {
            Law::Engine { .. } => Some(hinge.plan.limit.spring(blueprint.integration, step_secs)),
            Law::Constraints => None,
        };
        Self {
            springs: layout.hinges.iter().map(spring).collect(),
            step_secs,
            motors: {
                let still = |plan: &MotorPlan| Motor {
                    plan: plan.clone(),
                    control: 0.0,
                    activation: 0.0,
                    rate: 0.0,
                    start: 0.0,
                    mean_rate: 0.0,
                    turn: whole_turn(plan, layout),
                    is_limited: false,
                    thrust: 0.0,
                };
                blueprint.motors.iter().map(still).collect()
            },
            dampings: layout.hinges.iter().map(|hinge| hinge.plan.damping).collect(),
            tendons: {
                let acts = |tendon: &&TendonPlan| tendon.stiffness > 0.0 || tendon.damping > 0.0;
                blueprint.tendons.iter().filter(acts).cloned().collect()
            },
            drives: vec![Drive::default(); layout.hinges.len()],
            has_thrusts: blueprint.motors.iter().any(|motor| motor.thrust.is_some()),
            least_damping: match blueprint.implicit {
                ImplicitForces::All => f32::NEG_INFINITY,
                ImplicitForces::Nothing | ImplicitForces::Damping => 0.0,
            },
        }
    }

    /// Sets the torques of the motors and the dampings of the hinges to these multiples of the model's.
    pub(crate) fn vary(&mut self, robot: &Robot, strengths: &[f32], dampings: &[f32]) {
        let plans = &robot.blueprint.motors;
        for ((motor, plan), strength) in self.motors.iter_mut().zip(plans).zip(strengths) {
            motor.plan = plan.strengthened(*strength);
        }
        let hinges = &robot.layout.hinges;
        for ((damping, hinge), factor) in self.dampings.iter_mut().zip(hinges).zip(dampings) {
            *damping = factor * hinge.plan.damping;
        }
    }

    /// Resets controls, activations and past steps. Motors without feedback exert no torque until the next control.
    pub(crate) fn clear(&mut self) {
        self.drives.fill(Drive::default());
        self.motors.iter_mut().for_each(|motor| (motor.control, motor.activation) = (0.0, 0.0));
    }

    /// Activations of the motors that have one, `[m]`.
    pub(crate) fn activations(&mut self) -> impl Iterator<Item = &mut f32> {
        let motors = self.motors.iter_mut().filter(|motor| motor.plan.activation.is_some());
        motors.map(|motor| &mut motor.activation)
    }

    /// Sets the control of a motor, clamped to its range.
    pub(crate) fn command(&mut self, motor: usize, control: f32) {
        let motor = &mut self.motors[motor];
        motor.control = control.clamp(motor.plan.range[0], motor.plan.range[1]);
    }

    /// Moves the activations to the end of the step, with the mean rate of its stages, or `part` of a step from its start. The
    /// stage that was applied last has this weight in the mean.
    pub(crate) fn advance(&mut self, weight: f32, part: Option<f32>) {
        for motor in &mut self.motors {
            let Some(own) = &motor.plan.activation else { continue };
            motor.mean_rate += weight * motor.rate;
            motor.activation = match part {
                Some(part) => motor.start + part * self.step_secs * motor.rate,
                None => own.next(motor.start, motor.mean_rate, self.step_secs),
            };
        }
    }

    /// Applies the torques of the next physics step to the robot.
    pub(crate) fn apply(&mut self, robot: &mut Multibody, hinges: &[HingeMap]) {
        for motor in &mut self.motors {
            (motor.start, motor.mean_rate) = (motor.activation, 0.0);
        }
        self.apply_stage(robot, hinges);
    }

    /// Applies the torques of a stage of the step. The engine's spring has the torque `-k (q - rest)`. A weak spring with its
    /// rest at distance `torque / k` therefore adds a torque without a constraint.
    pub(crate) fn apply_stage(&mut self, robot: &mut Multibody, hinges: &[HingeMap]) {
        for (drive, hinge) in self.drives.iter_mut().zip(hinges) {
            let link = robot.link(hinge.link).expect("the layout is this robot's");
            drive.angle = hinge.position(link.joint());
            drive.speed = hinge.plan.axis.sign * robot.generalized_velocity()[hinge.dof];
            drive.last_torque = drive.torque;
            (drive.torque, drive.damping) = (0.0, 0.0);
        }
        self.actuate(hinges);
        for (index, hinge) in hinges.iter().enumerate() {
            let Drive { angle, speed, .. } = self.drives[index];
            let at = hinge.plan.axis.sign * angle;
            let limit = self.limit(index, hinge, angle, speed);
            let drive = &mut self.drives[index];
            drive.limit = limit;
            let spring = -hinge.plan.stiffness * (angle - hinge.plan.spring_rest);
            let explicit = drive.torque + drive.damping * speed;
            let torque = explicit + spring + limit.armature * limit.reference;
            drive.applied = torque;
            robot.armature_mut()[hinge.dof] = hinge.plan.armature + limit.armature;
            robot.damping_mut()[hinge.dof] = self.dampings[index] + drive.damping;
            if self.springs[index].is_none() {
                // Constraints take the torque as a number.
                continue;
            }
            let link = robot.link_mut(hinge.link).expect("the layout is this robot's");
            let rest = at + hinge.plan.axis.sign * torque / WEAK_SPRING;
            link.joint.set_spring(hinge.axis, WEAK_SPRING, rest);
        }
    }

    /// Torques of the hinges without damping, which is the multibody's, in the model's direction, N m.
    pub(super) fn torques(&self) -> impl Iterator<Item = f32> {
        self.drives.iter().map(|drive| drive.applied)
    }

    /// Forces of the motors on sites in the last stage, N, or N m.
    pub(super) fn thrusts(&self) -> impl Iterator<Item = (Thrust, f32)> {
        self.motors.iter().filter_map(|motor| Some((motor.plan.thrust?, motor.thrust)))
    }

    /// Damping of several hinges together, N s / m or N m s / rad of what moves them: of tendons, and of servos that no range
    /// limits. It is a part of [`Self::torques`].
    pub(super) fn shared_dampings(&self) -> impl Iterator<Item = (&Combination, f32)> {
        let motors = self.motors.iter().filter(|motor| !motor.is_limited).map(|motor| &motor.plan);
        let servos =
            motors.filter(|motor| motor.moved.only_hinge().is_none()).filter_map(|motor| {
                Some((&motor.moved, -motor.gear * motor.gear * motor.servo?.bias[2]))
            });
        let tendons = self.tendons.iter().map(|tendon| (&tendon.moved, tendon.damping));
        servos.chain(tendons).filter(|(_, damping)| *damping != 0.0)
    }

    /// Whether [`Self::count`] completes the torque of a hinge's motors, and limits it.
    pub(super) fn counts_forces_on_links(&self, hinge: &HingeMap) -> bool {
        hinge.plan.compensates_gravity || self.has_thrusts
    }

    /// Counts forces on links, N m, as a torque of a hinge's motors. Returns the change of the torque with which their sum is in
    /// `range`, and the damping that ends there, N m s / rad.
    pub(super) fn count(&mut self, index: usize, force: f32, range: Option<[f32; 2]>) -> [f32; 2] {
        let drive = &mut self.drives[index];
        let sum = drive.effort + force;
        drive.effort = range.map_or(sum, |[low, high]| sum.clamp(low, high));
        match drive.effort - sum {
            0.0 => [0.0; 2],
            change => [change, drive.damping],
        }
    }

    /// Torques of the motors in the last physics step, in the model's direction, N m.
    pub(super) fn efforts(&self) -> impl Iterator<Item = f32> {
        self.drives.iter().map(|drive| drive.effort)
    }

    /// Stores the accelerations of the last physics step.
    pub(crate) fn note(&mut self, robot: &Multibody, hinges: &[HingeMap]) {
        let speeds = robot.generalized_velocity();
        for (drive, hinge) in self.drives.iter_mut().zip(hinges) {
            let acceleration =
                (hinge.plan.axis.sign * speeds[hinge.dof] - drive.speed) / self.step_secs;
            let push = drive.limit.armature * (drive.limit.reference - acceleration);
            drive.free_acceleration = acceleration - hinge.axis_inverse_inertia * push;
        }
    }

    /// Computes the torques of motors and tendons. The part of a joint's servo that depends on the speed is damping, which
    /// a step may take implicitly, as MuJoCo's implicit integrators do; it ends where a range limits the torque.
    fn actuate(&mut self, hinges: &[HingeMap]) {
        let Self { motors, tendons, drives, has_thrusts, least_damping, .. } = self;
        for motor in motors {
            let mut input = motor.input(self.step_secs);
            let (turn, is_limited, thrust) = (motor.turn, &mut motor.is_limited, &mut motor.thrust);
            let motor = &motor.plan;
            let Some(servo) = motor.servo else {
                *thrust = motor.gear * input;
                for (hinge, factor) in motor.moved.0.iter() {
                    drives[*hinge].torque += factor * (motor.gear * input);
                }
                continue;
            };
            let position = motor.gear * motor.moved.sum(|hinge| drives[hinge].angle);
            if let Some(turn) = turn {
                // As in MuJoCo, it turns the shorter way.
                input -= turn * ((input - position) / turn).round();
            }
            let speed = motor.gear * motor.moved.sum(|hinge| drives[hinge].speed);
            let [constant, stiffness, slope] = servo.bias;
            let force = servo.gain * input + constant + stiffness * position + slope * speed;
            let limited = servo.range.map_or(force, |[low, high]| force.clamp(low, high));
            (*is_limited, *thrust) = (limited != force, motor.gear * limited);
            let only = motor.moved.only_hinge().filter(|_| limited == force);
            if let Some(hinge) = only {
                drives[hinge].damping -= motor.gear * motor.gear * slope;
            }
            for (hinge, factor) in motor.moved.0.iter() {
                drives[*hinge].torque += factor * (motor.gear * limited);
            }
        }
        for (drive, hinge) in drives.iter_mut().zip(hinges) {
            let is_complete = !hinge.plan.compensates_gravity && !*has_thrusts;
            if let Some([low, high]) = hinge.plan.torque_range.filter(|_| is_complete)
                && (drive.torque < low || drive.torque > high)
            {
                (drive.torque, drive.damping) = (drive.torque.clamp(low, high), 0.0);
            }
            drive.damping = drive.damping.max(*least_damping);
            drive.effort = drive.torque;
        }
        for tendon in tendons {
            let length = tendon.moved.sum(|hinge| drives[hinge].angle);
            let speed = tendon.moved.sum(|hinge| drives[hinge].speed);
            let force = tendon.passive_force(length, speed);
            for (hinge, factor) in tendon.moved.0.iter() {
                drives[*hinge].torque += factor * force;
            }
        }
    }

    /// Limit that the angle violates; zero if it is inactive.
    fn limit(&self, index: usize, hinge: &HingeMap, angle: f32, speed: f32) -> Limit {
        let (Some([low, high]), Some(spring)) = (hinge.plan.range, &self.springs[index]) else {
            return Limit::default();
        };
        let (low, high) = (low + hinge.plan.margin, high - hinge.plan.margin);
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
        let reference = (spring.next_speed(speed, position) - speed) / self.step_secs;
        let changed = hinge.axis_inverse_inertia * (drive.torque - drive.last_torque);
        if reference <= inward * (drive.free_acceleration + changed) {
            return Limit::default();
        }
        let compliance = hinge.plan.limit.compliance(-position) * hinge.inverse_inertia;
        Limit { armature: 1.0 / compliance, reference: inward * reference }
    }
}
