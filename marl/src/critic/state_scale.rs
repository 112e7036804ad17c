//! Scaling of the critic's input.

use libm::sqrt;
use policy::standardisation::LIMIT;

use crate::config::StateNorm;
use crate::data::running::RunningMoments;
use crate::error::MarlError;
use crate::state::Visitor;

/// Features with a standard deviation below this count as equal and are only centred.
const SMALLEST_DEVIATION: f64 = 1e-8;

/// A [`StateNorm`] with its statistics.
pub(crate) enum StateScale {
    AsShown,
    OwnFeatures,
    Running(RunningMoments),
}

impl StateScale {
    pub(crate) fn new(norm: StateNorm, features: usize) -> Self {
        match norm {
            StateNorm::None => Self::AsShown,
            StateNorm::FeatureZ => Self::OwnFeatures,
            StateNorm::Running => Self::Running(RunningMoments::new(features)),
        }
    }

    /// Scales states `[R, features]`.
    pub(crate) fn apply(&self, states: &mut [f32], features: usize) {
        match self {
            Self::AsShown => {}
            Self::OwnFeatures => states.chunks_exact_mut(features).for_each(standardise),
            Self::Running(moments) => moments.standardisation().apply(states),
        }
    }

    /// Adds the states `[R, features]` of `D_k`, for later iterations.
    pub(crate) fn take_in(&mut self, states: &[f32]) {
        if let Self::Running(moments) = self {
            moments.take_in(states);
        }
    }

    pub(crate) fn visit(
        &mut self,
        prefix: &str,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        match self {
            Self::AsShown | Self::OwnFeatures => Ok(()),
            Self::Running(moments) => moments.visit(prefix, visitor),
        }
    }
}

/// Standardises one state by the mean and standard deviation over its features.
fn standardise(state: &mut [f32]) {
    let count = state.len() as f64;
    let mean = state.iter().map(|&x| f64::from(x)).sum::<f64>() / count;
    let square = |&x: &f32| (f64::from(x) - mean) * (f64::from(x) - mean);
    let deviation = sqrt(state.iter().map(square).sum::<f64>() / count);
    let unit = if deviation > SMALLEST_DEVIATION { deviation } else { 1.0 };
    for x in state {
        *x = (((f64::from(*x) - mean) / unit) as f32).clamp(-LIMIT, LIMIT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scaled(scale: &StateScale) -> Vec<f32> {
        let mut states = vec![1.0, 3.0, 5.0, 5.0];
        scale.apply(&mut states, 2);
        states
    }

    #[test]
    fn state_norms_scale_by_a_states_features_by_previous_states_or_not() {
        let mut running = StateScale::new(StateNorm::Running, 2);
        assert_eq!(scaled(&running), [1.0, 3.0, 5.0, 5.0]);
        running.take_in(&[1.0, 0.0, 5.0, 4.0]); // means 3 and 2, standard deviations 2
        assert_eq!(scaled(&running), [-1.0, 0.5, 1.0, 1.5]);
        assert_eq!(scaled(&StateScale::new(StateNorm::FeatureZ, 2)), [-1.0, 1.0, 0.0, 0.0]);
        assert_eq!(scaled(&StateScale::new(StateNorm::None, 2)), [1.0, 3.0, 5.0, 5.0]);
    }
}
