//! Motors of a model with which random actions move little or only to the limits, so that a policy learns little.

use super::Robot;
use super::blueprint::MotorPlan;
use super::layout::{FASTEST, HingeMap};

/// Smallest useful share of a joint's range that a servo's targets cover, and of a control range that has an effect.
const SMALLEST_SHARE: f32 = 0.1;
/// Smallest useful change of a torque or speed over the control range, as a share of the largest.
const SMALLEST_CHANGE: f32 = 0.05;
/// Smallest useful acceleration of a joint by its motor alone, rad/s^2 or m/s^2.
const SLOWEST_ACCELERATION: f32 = 0.1;
/// Smallest useful speed, rad/s or m/s, and distance, rad or m, over a control range.
const SMALLEST_TARGET: f32 = 0.01;

/// What to change where `actions.scale` determines the controls, in place of the `ctrlrange`.
const SCALED: [(&str, &str); 4] = [
    ("widen `ctrlrange`", "raise `actions.scale`"),
    ("narrow `ctrlrange`", "lower `actions.scale`"),
    ("set `ctrlrange` to the joint's range", "change `actions.scale`"),
    ("its control range", "the range of its actions"),
];

impl Robot {
    /// Motors that a policy can hardly explore: one sentence each with the joint, the reason and what to change. `controls` are
    /// each motor's for the actions -1 and 1.
    pub(crate) fn hard_to_explore(&self, controls: &[[f32; 2]]) -> Vec<String> {
        let about = |(motor, controls): (&MotorPlan, &[f32; 2])| {
            let hinge = &self.layout.hinges[motor.moved.only_hinge()?];
            let step_secs = self.physics_step_secs() as f32;
            let why = Drive { motor, controls: *controls, hinge, step_secs }.fault()?;
            let width = |[low, high]: [f32; 2]| high - low;
            let excess = width(*controls) - width(motor.range);
            let is_scaled = excess.abs() > 1e-3 * width(motor.range);
            let words = SCALED.iter().filter(|_| is_scaled);
            let why = words.fold(why, |why, (from, to)| why.replace(from, to));
            Some(format!("the motor of `{}` {why}", motor.joint))
        };
        let motors = self.blueprint.motors.iter().zip(controls);
        motors.filter(|(motor, _)| !motor.integrates()).filter_map(about).collect()
    }
}

/// A motor on its joint.
struct Drive<'a> {
    motor: &'a MotorPlan,
    /// Controls for the actions -1 and 1.
    controls: [f32; 2],
    hinge: &'a HingeMap,
    /// Duration of a physics step, s.
    step_secs: f32,
}

impl Drive<'_> {
    /// Gain, and the constant, stiffness and slope of the feedback.
    fn law(&self) -> (f32, [f32; 3]) {
        self.motor.servo.map_or((1.0, [0.0; 3]), |servo| (servo.gain, servo.bias))
    }

    fn fault(&self) -> Option<String> {
        let (gain, [_, stiffness, slope]) = self.law();
        if self.motor.gear == 0.0 {
            return Some("has gear 0, so its control moves nothing: set `gear`".to_owned());
        }
        if gain == 0.0 {
            let why = "has gain 0, so its control moves nothing: set `kp`, `kv` or `gainprm`";
            return Some(why.to_owned());
        }
        // As the motor does.
        let [low, high] = self.motor.range;
        let limited = self.controls.map(|control| control.clamp(low, high));
        let share = (limited[1] - limited[0]) / (self.controls[1] - self.controls[0]);
        if share < SMALLEST_SHARE {
            return Some(format!(
                "has controls from {} to {} for a `ctrlrange` from {low} to {high}, so {:.1} % of its control range has an \
                 effect: narrow `ctrlrange`, which is in the unit of the joint (rad, not degrees)",
                self.controls[0],
                self.controls[1],
                100.0 * share
            ));
        }
        let ends = |by: f32| {
            let (gain, [constant, ..]) = self.law();
            let [a, b] = limited.map(|control| (gain * control + constant) * by);
            [a.min(b), a.max(b)]
        };
        match (stiffness, slope) {
            (0.0, 0.0) => self.fault_of_torque(ends(self.motor.gear)),
            (0.0, slope) => self.fault_of_speed(ends(-1.0 / (slope * self.motor.gear))),
            (stiffness, _) => self.fault_of_target(ends(-1.0 / (stiffness * self.motor.gear))),
        }
    }

    /// For a motor without feedback, whose torques these are at the ends of its control range.
    fn fault_of_torque(&self, [low, high]: [f32; 2]) -> Option<String> {
        let [unit, newtons] = self.hinge.units();
        let force = self.motor.servo.and_then(|servo| servo.range);
        let force = force.map(|range| range.map(|end| end * self.motor.gear));
        let limits = [force, self.hinge.plan.torque_range].into_iter().flatten();
        let clipped =
            limits.fold([low, high], |ends, [a, b]| ends.map(|end| end.clamp(a.min(b), a.max(b))));
        let share = (clipped[1] - clipped[0]) / (high - low);
        if share < SMALLEST_SHARE {
            return Some(format!(
                "asks for {low} to {high} {newtons} and gets {} to {}, so {:.1} % of its control range has an effect: \
                 narrow `ctrlrange`, or widen `forcerange` or `actuatorfrcrange`",
                clipped[0],
                clipped[1],
                100.0 * share
            ));
        }
        let [low, high] = clipped;
        let largest = low.abs().max(high.abs());
        if (high - low) < SMALLEST_CHANGE * largest {
            return Some(format!(
                "always exerts {low} to {high} {newtons}, almost the same: widen `ctrlrange`"
            ));
        }
        let acceleration = largest * self.hinge.axis_inverse_inertia;
        if acceleration < SLOWEST_ACCELERATION {
            return Some(format!(
                "exerts {largest} {newtons} at most, which accelerates the joint by {acceleration:.2e} {unit}/s^2: raise \
                 `gear` or widen `ctrlrange`"
            ));
        }
        (acceleration * self.step_secs > FASTEST).then(|| {
            format!(
                "exerts up to {largest} {newtons}, which accelerates the joint to {:.2e} {unit}/s in one physics step: \
                 lower `gear` or narrow `ctrlrange`",
                acceleration * self.step_secs
            )
        })
    }

    /// For a servo of the speed with these targets at the ends of its control range.
    fn fault_of_speed(&self, [low, high]: [f32; 2]) -> Option<String> {
        let [unit, _] = self.hinge.units();
        let largest = low.abs().max(high.abs());
        if high - low < SMALLEST_TARGET.max(SMALLEST_CHANGE * largest) {
            return Some(format!(
                "always asks for {low} to {high} {unit}/s, almost the same: widen `ctrlrange`"
            ));
        }
        (largest > FASTEST).then(|| {
            format!("asks for up to {largest} {unit}/s: narrow `ctrlrange` or raise `gear`")
        })
    }

    /// For a servo of the position with these targets at the ends of its control range.
    fn fault_of_target(&self, [low, high]: [f32; 2]) -> Option<String> {
        let [unit, _] = self.hinge.units();
        let Some([start, end]) = self.hinge.plan.range else {
            return (high - low < SMALLEST_TARGET).then(|| {
                format!(
                    "has targets from {low} to {high} {unit}, almost the same: widen `ctrlrange`"
                )
            });
        };
        let shared = (high.min(end) - low.max(start)).max(0.0);
        let place = format!(
            "has targets from {low} to {high} {unit} for a joint from {start} to {end} {unit}"
        );
        if shared < SMALLEST_SHARE * (end - start).min(high - low) {
            return Some(format!(
                "{place}, almost all outside: set `ctrlrange` to the joint's range"
            ));
        }
        if shared < SMALLEST_SHARE * (end - start) {
            let share = 100.0 * shared / (end - start);
            return Some(format!(
                "{place}, so it reaches {share:.1} % of the joint's range: widen `ctrlrange`"
            ));
        }
        let share = shared / (high - low);
        (share < SMALLEST_SHARE).then(|| {
            format!(
                "{place}, so {:.1} % of its control range has an effect: narrow `ctrlrange`, which is in the unit of the \
                 joint ({unit}, not degrees)",
                100.0 * share
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::TaskFile;

    /// What `hard_to_explore` says of the example with another motor of its hip.
    fn hints(motor: &str) -> Vec<String> {
        let model = include_str!("../../assets/hopper.xml");
        let hip = "<motor name=\"hip\" joint=\"hip\" gear=\"80\"/>";
        assert!(model.contains(hip));
        let file = TaskFile::parse(include_str!("../../assets/hopper.toml")).unwrap();
        let robot = Robot::build(file.robot_row(model.replace(hip, motor))).unwrap();
        robot.hard_to_explore(&controls(&robot))
    }

    /// The controls of all motors for the actions -1 and 1 without `[actions]`.
    fn controls(robot: &Robot) -> Vec<[f32; 2]> {
        robot.blueprint.motors.iter().map(|motor| motor.range).collect()
    }

    #[test]
    fn a_motor_that_random_actions_cannot_explore_is_named_with_what_to_change() {
        for (motor, part) in [
            ("motor joint=\"hip\" gear=\"0\"", "has gear 0"),
            ("position joint=\"hip\" kp=\"0\" ctrlrange=\"-1 1\"", "has gain 0"),
            (
                "motor joint=\"hip\" gear=\"80\" ctrlrange=\"0.999 1\"",
                "almost the same: widen `ctrlrange`",
            ),
            ("motor joint=\"hip\" ctrlrange=\"-1e-4 1e-4\"", "raise `gear`"),
            ("motor joint=\"hip\" gear=\"1e7\"", "lower `gear`"),
            ("motor joint=\"hip\" ctrlrange=\"-80 80\" forcerange=\"-1 1\"", "narrow `ctrlrange`"),
            (
                "position joint=\"hip\" kp=\"50\" ctrlrange=\"0 0.1\"",
                "so it reaches 5.0 % of the joint's range",
            ),
            ("position joint=\"hip\" kp=\"50\" ctrlrange=\"-90 90\"", "not degrees"),
            ("position joint=\"hip\" kp=\"50\" ctrlrange=\"2 3\"", "almost all outside"),
            ("velocity joint=\"hip\" kv=\"5\" ctrlrange=\"-1e-3 1e-3\"", "almost the same"),
            (
                "velocity joint=\"hip\" kv=\"5\" ctrlrange=\"-5000 5000\"",
                "asks for up to 5000 rad/s",
            ),
        ] {
            let hints = hints(&format!("<{motor}/>"));
            assert_eq!(hints.len(), 1, "{motor}: {hints:?}");
            assert!(
                hints[0].starts_with("the motor of `hip` ") && hints[0].contains(part),
                "{hints:?}"
            );
        }
    }

    #[test]
    fn a_motor_that_a_policy_can_explore_is_not_named() {
        for motor in [
            "motor joint=\"hip\" ctrlrange=\"-80 80\"",
            "motor joint=\"hip\" gear=\"-80\" ctrlrange=\"0 1\"",
            "motor joint=\"hip\" gear=\"80\" forcerange=\"-0.5 0.5\"",
            "position joint=\"hip\" kp=\"50\" kv=\"2\" ctrlrange=\"-0.5 1.5\"",
            "position joint=\"hip\" kp=\"50\" ctrlrange=\"-3.14 3.14\"",
            "position joint=\"hip\" kp=\"50\" ctrlrange=\"0 0.5\"",
            "velocity joint=\"hip\" kv=\"5\" ctrlrange=\"-3 3\"",
        ] {
            assert_eq!(hints(&format!("<{motor}/>")), [""; 0], "{motor}");
        }
    }
}
