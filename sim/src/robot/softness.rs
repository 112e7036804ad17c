//! MuJoCo's soft constraints, used for contacts and joint limits: their force as a function of the violation.

use serde::Deserialize;

use crate::arrays;

/// MuJoCo's integrator for a robot. The springs of soft constraints are integrated in the same way.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Integration {
    /// Semi-implicit Euler, with the spring's acceleration at the start of the step.
    Euler,
    /// Runge-Kutta of fourth order; here the exact motion of the spring.
    RungeKutta,
}

/// Forces that a step of MuJoCo's integrator takes at the end of the step, to first order in the velocities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ImplicitForces {
    /// None: Runge-Kutta, or Euler with the flag `eulerdamp` disabled.
    Nothing,
    /// Euler: the damping of joints, and here also the speed terms of servos of one joint.
    Damping,
    /// Also the forces of servos and tendons on several joints, and those of positive speed terms.
    All,
}

/// MuJoCo's `solref` and `solimp`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Softness {
    pub(crate) reference: Reference,
    /// Impedance without violation and at violations of `width` or more, each in `(0, 1)`.
    pub(crate) impedance: [f32; 2],
    /// Violation at which the impedance is largest, m or rad; 0 for the mean impedance at all violations.
    pub(crate) width: f32,
    /// Violation, as a fraction of `width`, at which the two parts of the impedance's curve meet.
    pub(crate) midpoint: f32,
    /// Exponent of these parts.
    pub(crate) power: f32,
}

/// MuJoCo's `solref`: the spring and damper of a constraint that resists alone.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Reference {
    /// Two positive numbers: time constant, s, and damping ratio.
    Timed { time_constant_secs: f32, damping_ratio: f32 },
    /// Two negative numbers, here positive: stiffness, 1/s^2, and damping, 1/s.
    Direct { stiffness: f32, damping: f32 },
}

/// Numbers that replace those of a model.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SoftnessOverride {
    /// A spring with this time constant, s, and a damping ratio of 1 in place of [`Softness::reference`].
    pub(crate) time_constant_secs: Option<f32>,
    /// In place of [`Softness::impedance`].
    #[serde(default, deserialize_with = "arrays::given")]
    pub(crate) impedance: Option<[f32; 2]>,
    /// In place of [`Softness::width`], m or rad.
    pub(crate) width: Option<f32>,
}

/// Widths up to this are none, as in MuJoCo.
const LEAST_WIDTH: f64 = 1e-15;

/// Smallest impedance and midpoint, as in MuJoCo.
const SMALLEST_IMPEDANCE: f32 = 1e-4;

/// Largest impedance and midpoint, as in MuJoCo.
const LARGEST_IMPEDANCE: f64 = 0.9999;

impl Softness {
    /// MuJoCo's default `solref` and `solimp`.
    pub(crate) const DEFAULT: ([f64; 2], [f64; 5]) = ([0.02, 1.0], [0.9, 0.95, 0.001, 0.5, 2.0]);

    /// Softness for MuJoCo's `solref` and `solimp` and a physics step of `step_secs`.
    pub(super) fn new(
        solref: [f64; 2],
        [first, last, width, midpoint, power]: [f64; 5],
        step_secs: f64,
    ) -> Self {
        let bounded = |d: f64| d.clamp(f64::from(SMALLEST_IMPEDANCE), LARGEST_IMPEDANCE) as f32;
        Self {
            reference: Reference::new(solref, step_secs),
            impedance: [bounded(first), bounded(last)],
            width: if width > LEAST_WIDTH { width as f32 } else { 0.0 },
            midpoint: bounded(midpoint),
            power: power.max(1.0) as f32,
        }
    }

    /// Why MuJoCo has no spring for these two numbers, if it has none.
    pub(super) fn check(name: &str, [first, second]: [f64; 2]) -> Result<(), String> {
        if first != 0.0 && (first > 0.0) == (second > 0.0) {
            return Ok(());
        }
        Err(format!("the two numbers of its `{name}` must both be positive, or both negative"))
    }

    /// Whether it is critically damped and has MuJoCo's default curve of the impedance.
    pub(super) fn is_plain(&self) -> bool {
        let is_critical = |reference: &Reference| match reference {
            Reference::Timed { damping_ratio, .. } => (damping_ratio - 1.0).abs() <= 1e-6,
            Reference::Direct { .. } => false,
        };
        is_critical(&self.reference) && [self.midpoint, self.power] == [0.5, 2.0]
    }

    /// The softness with other numbers, for a physics step of `step_secs`. A stated time constant is of a critically damped
    /// spring.
    pub(super) fn with(&self, other: &SoftnessOverride, step_secs: f64) -> Self {
        let timed = |secs: f32| Reference::new([f64::from(secs), 1.0], step_secs);
        Self {
            reference: other.time_constant_secs.map_or(self.reference, timed),
            impedance: other.impedance.unwrap_or(self.impedance),
            width: other.width.unwrap_or(self.width),
            ..*self
        }
    }

    /// Compliance of a constraint in units of its inverse mass, `R / A = (1 - d) / d`.
    pub(crate) fn compliance(&self, violation: f32) -> f32 {
        let impedance = self.impedance_at(violation);
        (1.0 - impedance) / impedance
    }

    /// Impedance `d`, interpolated over `width` by two power functions.
    pub(crate) fn impedance_at(&self, violation: f32) -> f32 {
        let [first, last] = self.impedance;
        if self.width == 0.0 {
            return 0.5 * (first + last);
        }
        let x = (violation / self.width).clamp(0.0, 1.0);
        let [mid, power] = [self.midpoint, self.power];
        // MuJoCo's default is computed without the library's powers.
        let y = match (power == 2.0, x < mid) {
            (true, true) => x * x / mid,
            (true, false) => 1.0 - (1.0 - x) * (1.0 - x) / (1.0 - mid),
            (false, true) => mid * libm::powf(x / mid, power),
            (false, false) => 1.0 - (1.0 - mid) * libm::powf((1.0 - x) / (1.0 - mid), power),
        };
        (first + (last - first) * y).max(SMALLEST_IMPEDANCE)
    }

    /// Stiffness `k`, 1/s^2, and damping `b`, 1/s, of MuJoCo's reference acceleration `-b v - k d(r) r`.
    pub(crate) fn stiffness_and_damping(&self) -> [f64; 2] {
        let last = f64::from(self.impedance[1]);
        match self.reference {
            Reference::Timed { time_constant_secs, damping_ratio } => {
                let rate = 1.0 / (last * f64::from(time_constant_secs));
                let stiffness = rate / f64::from(damping_ratio);
                [stiffness * stiffness, 2.0 * rate]
            }
            Reference::Direct { stiffness, damping } => {
                [f64::from(stiffness) / (last * last), f64::from(damping) / last]
            }
        }
    }

    /// Reference acceleration of the constraint at `position`, m or rad, negative for a violation, and `speed`.
    /// Friction has no position.
    pub(crate) fn reference_acceleration(&self, position: Option<f64>, speed: f64) -> f64 {
        let at = position.unwrap_or(0.0);
        self.acceleration_at(-at, [at, speed])
    }

    /// As [`Self::reference_acceleration`], for one of several directions that together have the violation `violation`, m.
    pub(crate) fn acceleration_at(&self, violation: f64, [at, speed]: [f64; 2]) -> f64 {
        let [stiffness, damping] = self.stiffness_and_damping();
        let stiffness = stiffness * f64::from(self.impedance_at(violation as f32));
        -stiffness * at - damping * speed
    }

    /// Spring of the constraint for steps of `step_secs`.
    pub(crate) fn spring(&self, integration: Integration, step_secs: f32) -> Spring {
        let rate = match self.reference {
            Reference::Timed { time_constant_secs, .. } => {
                1.0 / (self.impedance[1] * time_constant_secs)
            }
            Reference::Direct { stiffness, .. } => stiffness.sqrt() / self.impedance[1],
        };
        Spring { integration, rate, decay: libm::expf(-rate * step_secs), step_secs }
    }
}

impl Reference {
    fn new([first, second]: [f64; 2], step_secs: f64) -> Self {
        if first > 0.0 {
            // As in MuJoCo, a spring is never faster than two steps.
            let time_constant_secs = first.max(2.0 * step_secs) as f32;
            return Self::Timed { time_constant_secs, damping_ratio: second as f32 };
        }
        Self::Direct { stiffness: -first as f32, damping: -second as f32 }
    }
}

/// A critically damped spring, `dv/dt = -2 w v - w^2 r` with `w = 1 / (d_max time_constant)`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spring {
    integration: Integration,
    /// `w`, 1/s.
    rate: f32,
    /// `exp(-w dt)`.
    decay: f32,
    step_secs: f32,
}

impl Spring {
    /// Speed at the end of a step that starts with `speed` and `position`, which is negative for a violation.
    pub(crate) fn next_speed(&self, speed: f32, position: f32) -> f32 {
        let turn = self.rate * self.step_secs;
        match self.integration {
            Integration::Euler => speed - turn * (2.0 * speed + self.rate * position),
            Integration::RungeKutta => self.decay * (speed - turn * (speed + self.rate * position)),
        }
    }

    /// Relative loss of a sliding contact's speed by damping in a step.
    pub(crate) fn damping(&self) -> f32 {
        2.0 * self.rate * self.step_secs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// MuJoCo's default.
    const DEFAULT: Softness = Softness {
        reference: Reference::Timed { time_constant_secs: 0.02, damping_ratio: 1.0 },
        impedance: [0.9, 0.95],
        width: 0.001,
        midpoint: 0.5,
        power: 2.0,
    };

    #[test]
    fn the_impedance_rises_from_its_first_to_its_last_value() {
        let softness = Softness { impedance: [0.0, 0.8], width: 0.01, ..DEFAULT };
        assert_eq!(softness.impedance_at(0.0), SMALLEST_IMPEDANCE);
        assert!((softness.impedance_at(0.005) - 0.4).abs() < 1e-6);
        assert_eq!(softness.impedance_at(0.02), 0.8);
        assert!((softness.compliance(0.02) - 0.25).abs() < 1e-6);
    }

    #[test]
    fn a_stated_time_constant_is_at_least_two_steps_as_a_models() {
        for (stated, expected) in [(0.001, 0.004), (0.004, 0.004), (0.3, 0.3)] {
            let other = SoftnessOverride { time_constant_secs: Some(stated), ..Default::default() };
            let with = DEFAULT.with(&other, 0.002).stiffness_and_damping();
            let model = Softness::new([f64::from(stated), 1.0], Softness::DEFAULT.1, 0.002);
            assert_eq!(with, model.stiffness_and_damping());
            let plain = Reference::Timed { time_constant_secs: expected, damping_ratio: 1.0 };
            assert_eq!(with, Softness { reference: plain, ..DEFAULT }.stiffness_and_damping());
        }
    }

    #[test]
    fn both_integrations_agree_over_short_steps_and_return_to_rest() {
        let [euler, exact] = [Integration::Euler, Integration::RungeKutta]
            .map(|integration| DEFAULT.spring(integration, 1e-5));
        let (speed, position) = (-1.0, -0.01);
        assert!(
            (euler.next_speed(speed, position) - exact.next_speed(speed, position)).abs() < 1e-5
        );
        assert_eq!(exact.next_speed(0.0, 0.0), 0.0);
    }
}
