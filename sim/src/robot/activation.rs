//! Activations: what an actuator keeps between steps, which its gain multiplies instead of the control.

use proto::ActivationKind;

/// How MuJoCo's activation of an actuator follows its control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Activation {
    pub(crate) kind: ActivationKind,
    /// Of a filter, s.
    pub(crate) time_constant_secs: f32,
    /// Range of the activation, if the model limits it.
    pub(crate) range: Option<[f32; 2]>,
    /// Whether the force in a step is that of the activation at its end.
    pub(crate) is_early: bool,
}

/// Largest activation of a model that does not limit it, as that of the controls in a state.
const LARGEST: f32 = 1e9;

impl Activation {
    /// The rate of an activation with a control, 1/s.
    pub(crate) fn rate(&self, activation: f32, control: f32) -> f32 {
        match self.kind {
            ActivationKind::Integrator => control,
            ActivationKind::Filter | ActivationKind::FilterExact => {
                (control - activation) / self.time_constant_secs
            }
        }
    }

    /// The activation after a step of `step_secs` with this rate at its start.
    pub(crate) fn next(&self, activation: f32, rate: f32, step_secs: f32) -> f32 {
        let secs = match self.kind {
            ActivationKind::Integrator | ActivationKind::Filter => step_secs,
            ActivationKind::FilterExact => {
                -libm::expm1f(-step_secs / self.time_constant_secs) * self.time_constant_secs
            }
        };
        let next = activation + secs * rate;
        let [low, high] = self.range.unwrap_or([-LARGEST, LARGEST]);
        next.clamp(low, high)
    }

    /// Inputs of the force at the ends of these controls: the controls, limited by a filter's range, or the bounds of an
    /// integrator's activation.
    pub(crate) fn inputs(&self, controls: [f32; 2]) -> [f32; 2] {
        match (self.kind, self.range) {
            (ActivationKind::Integrator, _) => self.bounds(),
            (_, Some([low, high])) => controls.map(|end| end.clamp(low, high)),
            (_, None) => controls,
        }
    }

    /// Bounds of the activation in a state; it starts at 0, also outside its range.
    pub(crate) fn bounds(&self) -> [f32; 2] {
        let [low, high] = self.range.unwrap_or([-LARGEST, LARGEST]);
        [low.min(0.0), high.max(0.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// MuJoCo 4.0.0: `act` of a `general` after ten steps of 2 ms with the control 0.8 and `dynprm` 0.05, and of an integrator
    /// whose `actrange` ends at 0.01.
    #[test]
    fn activations_follow_their_controls_as_in_mujoco() {
        for (kind, range, expected) in [
            (ActivationKind::Filter, None, 0.268_133_9),
            (ActivationKind::FilterExact, None, 0.263_743_97),
            (ActivationKind::Integrator, None, 0.016),
            (ActivationKind::Integrator, Some([-0.01, 0.01]), 0.01),
        ] {
            let own = Activation { kind, time_constant_secs: 0.05, range, is_early: false };
            let step = |activation: f32, _| own.next(activation, own.rate(activation, 0.8), 0.002);
            let end = (0..10).fold(0.0, step);
            assert!((end - expected).abs() < 1e-6, "{kind:?}: {end} against {expected}");
        }
    }
}
