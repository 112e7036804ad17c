//! MuJoCo's soft constraints, used for contacts and joint limits: their force as a function of the violation.

use serde::Deserialize;

/// MuJoCo's integrator for a robot. The springs of soft constraints are integrated in the same way.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Integration {
    /// Semi-implicit Euler, with the spring's acceleration at the start of the step.
    Euler,
    /// Runge-Kutta of fourth order; here the exact motion of the spring.
    RungeKutta,
}

/// MuJoCo's `solref` with a damping ratio of 1, and its `solimp` with midpoint 0.5 and power 2.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Softness {
    /// First number of `solref`, s.
    pub(crate) time_constant_secs: f32,
    /// Impedance without violation and at violations of `width` or more, each in `[0, 1)`.
    pub(crate) impedance: [f32; 2],
    /// Violation at which the impedance is largest, m or rad.
    pub(crate) width: f32,
}

/// Numbers that replace those of a model.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SoftnessOverride {
    /// In place of [`Softness::time_constant_secs`], s.
    pub(crate) time_constant_secs: Option<f32>,
    /// In place of [`Softness::impedance`].
    pub(crate) impedance: Option<[f32; 2]>,
    /// In place of [`Softness::width`], m or rad.
    pub(crate) width: Option<f32>,
}

/// Smallest impedance, as in MuJoCo.
const SMALLEST_IMPEDANCE: f32 = 1e-4;

/// Largest impedance, as in MuJoCo.
const LARGEST_IMPEDANCE: f64 = 0.9999;

impl Softness {
    /// Softness for MuJoCo's `solref` and `solimp` and a physics step of `step_secs`.
    pub(super) fn new(
        [time_constant, damping]: [f64; 2],
        [first, last, width, midpoint, power]: [f64; 5],
        step_secs: f64,
    ) -> Result<Self, String> {
        if time_constant <= 0.0 || (damping - 1.0).abs() > 1e-6 {
            return Err("the damping ratio of its `solref` must be 1".to_owned());
        }
        if [midpoint, power] != [0.5, 2.0] {
            return Err("the midpoint and power of its `solimp` must be 0.5 and 2".to_owned());
        }
        let impedance = |d: f64| d.clamp(f64::from(SMALLEST_IMPEDANCE), LARGEST_IMPEDANCE) as f32;
        Ok(Self {
            // As in MuJoCo, a spring is never faster than two steps.
            time_constant_secs: time_constant.max(2.0 * step_secs) as f32,
            impedance: [impedance(first), impedance(last)],
            width: width.max(1e-9) as f32,
        })
    }

    /// The softness with other numbers.
    pub(super) fn with(&self, other: &SoftnessOverride) -> Self {
        Self {
            time_constant_secs: other.time_constant_secs.unwrap_or(self.time_constant_secs),
            impedance: other.impedance.unwrap_or(self.impedance),
            width: other.width.unwrap_or(self.width),
        }
    }

    /// Compliance of a constraint in units of its inverse mass, `R / A = (1 - d) / d`.
    pub(crate) fn compliance(&self, violation: f32) -> f32 {
        let impedance = self.impedance_at(violation);
        (1.0 - impedance) / impedance
    }

    /// Impedance `d`, interpolated over `width` by two parabolas.
    fn impedance_at(&self, violation: f32) -> f32 {
        let [first, last] = self.impedance;
        let x = (violation / self.width).clamp(0.0, 1.0);
        let y = if x < 0.5 { 2.0 * x * x } else { 1.0 - 2.0 * (1.0 - x) * (1.0 - x) };
        (first + (last - first) * y).max(SMALLEST_IMPEDANCE)
    }

    /// Spring of the constraint for steps of `step_secs`.
    pub(crate) fn spring(&self, integration: Integration, step_secs: f32) -> Spring {
        let rate = 1.0 / (self.impedance[1] * self.time_constant_secs);
        Spring { integration, rate, decay: libm::expf(-rate * step_secs), step_secs }
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
    const DEFAULT: Softness =
        Softness { time_constant_secs: 0.02, impedance: [0.9, 0.95], width: 0.001 };

    #[test]
    fn the_impedance_rises_from_its_first_to_its_last_value() {
        let softness = Softness { impedance: [0.0, 0.8], width: 0.01, ..DEFAULT };
        assert_eq!(softness.impedance_at(0.0), SMALLEST_IMPEDANCE);
        assert!((softness.impedance_at(0.005) - 0.4).abs() < 1e-6);
        assert_eq!(softness.impedance_at(0.02), 0.8);
        assert!((softness.compliance(0.02) - 0.25).abs() < 1e-6);
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
