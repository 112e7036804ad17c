//! Motors of a model with which random actions move little or only to the limits, so that a policy learns little.

use rapier3d::glamx::DVec3;

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
            let hinge = motor.moved.only_hinge().map(|hinge| &self.layout.hinges[hinge]);
            let inverse_inertia = match hinge {
                Some(hinge) => Some(hinge.axis_inverse_inertia),
                None => self.inverse_pushed_mass(motor),
            };
            let step_secs = self.physics_step_secs() as f32;
            let unit = self.unit_of(motor);
            let drive =
                Drive { motor, controls: *controls, hinge, inverse_inertia, step_secs, unit };
            let why = drive.fault()?;
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

    /// Inverse mass of the robot that a force on a site pushes, 1/kg; `None` for other motors.
    fn inverse_pushed_mass(&self, motor: &MotorPlan) -> Option<f32> {
        let thrust = motor.thrust.filter(|thrust| thrust.force != DVec3::ZERO)?;
        let tree = self.blueprint.tree_of(thrust.link);
        let links = self.blueprint.links.iter().enumerate();
        let own = links.filter(|(index, _)| self.blueprint.tree_of(*index) == tree);
        Some(1.0 / own.map(|(_, link)| link.mass.mass()).sum::<f32>())
    }
}

/// A motor on what it moves.
struct Drive<'a> {
    motor: &'a MotorPlan,
    /// Controls for the actions -1 and 1.
    controls: [f32; 2],
    /// Its joint, if it moves a single one.
    hinge: Option<&'a HingeMap>,
    /// Acceleration of that joint, or of the robot by a force on a site, per torque or force, 1/(kg m^2) or 1/kg.
    inverse_inertia: Option<f32>,
    /// Duration of a physics step, s.
    step_secs: f32,
    /// Unit of its torque or force.
    unit: &'static str,
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
            let inputs = self.motor.activation.map_or(limited, |own| own.inputs(limited));
            let [a, b] = inputs.map(|input| (gain * input + constant) * by);
            [a.min(b), a.max(b)]
        };
        match (stiffness, slope) {
            (0.0, 0.0) => self.fault_of_torque(ends(self.motor.gear)),
            _ if self.is_weak(self.largest_of_servo()) => {
                Some(self.too_weak(self.largest_of_servo()))
            }
            (0.0, slope) => self.fault_of_speed(ends(-1.0 / (slope * self.motor.gear))),
            (stiffness, _) => self.fault_of_target(ends(-1.0 / (stiffness * self.motor.gear))),
        }
    }

    /// For a motor without feedback, whose torques these are at the ends of its control range.
    fn fault_of_torque(&self, [low, high]: [f32; 2]) -> Option<String> {
        let [unit, newtons] = self.units();
        let force = self.motor.servo.and_then(|servo| servo.range);
        let force = force.map(|range| range.map(|end| end * self.motor.gear));
        let torque = self.hinge.and_then(|hinge| hinge.plan.torque_range);
        let limits = [force, torque].into_iter().flatten();
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
        if self.is_weak(largest) {
            return Some(self.too_weak(largest));
        }
        let speed = largest * self.inverse_inertia? * self.step_secs;
        (speed > FASTEST).then(|| {
            format!(
                "exerts up to {largest} {newtons}, which accelerates {} to {speed:.2e} {unit}/s in one physics step: \
                 lower `gear` or narrow `ctrlrange`",
                self.moved()
            )
        })
    }

    /// Units of the position and of the torque or force.
    fn units(&self) -> [&'static str; 2] {
        [if self.unit == "N m" { "rad" } else { "m" }, self.unit]
    }

    /// What it moves, in words.
    fn moved(&self) -> &'static str {
        if self.motor.thrust.is_some() { "the robot" } else { "the joint" }
    }

    /// Whether this largest torque or force hardly moves anything.
    fn is_weak(&self, largest: f32) -> bool {
        self.inverse_inertia.is_some_and(|inverse| largest * inverse < SLOWEST_ACCELERATION)
    }

    fn too_weak(&self, largest: f32) -> String {
        let [unit, newtons] = self.units();
        let acceleration = largest * self.inverse_inertia.unwrap_or_default();
        let force = self.motor.servo.and_then(|servo| servo.range);
        let activation = self.motor.activation.and_then(|own| own.range);
        let advice = match (force, activation) {
            (Some(_), _) => "raise `gear`, or widen `ctrlrange` and `forcerange`",
            (None, Some(_)) => "raise `gear`, or widen `ctrlrange` and `actrange`",
            (None, None) => "raise `gear` or widen `ctrlrange`",
        };
        format!(
            "exerts {largest} {newtons} at most, which accelerates {} by {acceleration:.2e} {unit}/s^2: {advice}",
            self.moved()
        )
    }

    /// Largest torque or force of a servo with a limit; infinite without one.
    fn largest_of_servo(&self) -> f32 {
        let range = self.motor.servo.and_then(|servo| servo.range);
        let largest = |[low, high]: [f32; 2]| self.motor.gear.abs() * low.abs().max(high.abs());
        range.map_or(f32::INFINITY, largest)
    }

    /// For a servo of the speed with these targets at the ends of its control range.
    fn fault_of_speed(&self, [low, high]: [f32; 2]) -> Option<String> {
        let [unit, _] = self.hinge?.units();
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
        let hinge = self.hinge?;
        let [unit, _] = hinge.units();
        let Some([start, end]) = hinge.plan.range else {
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
                "general joint=\"hip\" dyntype=\"filterexact\" dynprm=\"0.1\" gainprm=\"4\" \
                 actrange=\"-1e-5 1e-5\" ctrlrange=\"-1 1\"",
                "widen `ctrlrange` and `actrange`",
            ),
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
            (
                "position joint=\"hip\" kp=\"50\" ctrlrange=\"0 1\" forcerange=\"-1e-6 1e-6\"",
                "widen `ctrlrange` and `forcerange`",
            ),
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
    fn a_motor_on_a_site_or_a_tendon_that_random_actions_cannot_explore_is_named() {
        for (motor, part) in [
            ("motor site=\"s\" gear=\"0 0 0\"", "has gear 0"),
            ("motor site=\"s\" gear=\"0 0 1\" ctrlrange=\"0 1e-4\"", "accelerates the robot by"),
            (
                "motor site=\"s\" gear=\"0 0 1\" ctrlrange=\"15 25\" forcerange=\"0 1\"",
                "so 0.0 % of its control range has an effect",
            ),
            ("motor site=\"s\" gear=\"0 0 1\" ctrlrange=\"24.9 25\"", "almost the same"),
            ("motor tendon=\"t\" gear=\"0\"", "has gear 0"),
            ("position tendon=\"t\" kp=\"0\" ctrlrange=\"-1 1\"", "has gain 0"),
            ("motor site=\"s\" gear=\"0 0 1\" ctrlrange=\"0 25\"", ""),
            ("motor tendon=\"t\" ctrlrange=\"-5 5\"", ""),
        ] {
            let model = format!(
                "<mujoco><default><motor ctrlrange=\"-1 1\"/></default><worldbody><body><freejoint/><site name=\"s\"/><geom size=\"0.1\" mass=\"1\"/>\
                 <body pos=\"1 0 0\"><joint name=\"a\"/><geom size=\"0.1\" mass=\"1\"/>\
                 <body pos=\"1 0 0\"><joint name=\"b\"/><geom size=\"0.1\" mass=\"1\"/></body></body></body></worldbody>\
                 <tendon><fixed name=\"t\"><joint joint=\"a\" coef=\"1\"/><joint joint=\"b\" coef=\"1\"/></fixed></tendon>\
                 <actuator><{motor}/></actuator></mujoco>"
            );
            let file = |_: &str| Ok(model.as_bytes().to_vec());
            let robot = Robot::of_model("model.xml", file).unwrap();
            let hints = robot.hard_to_explore(&controls(&robot));
            assert_eq!(hints.len(), usize::from(!part.is_empty()), "{motor}: {hints:?}");
            assert!(hints.iter().all(|hint| hint.contains(part)), "{hints:?}");
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
