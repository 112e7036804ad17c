//! What an agent sees: the observation's layout and its scaling.
//!
//! In `full_id` agent `i` of `n` sees the global state followed by the one-hot number `i`. `feature_z` standardises
//! this vector by the mean `m` and deviation `s` over its **own** features, the number included, as the published
//! code did. Two things follow. First, the one-hot part adds one 1 and `n - 1` zeros whatever `i` is, so `m` and
//! `s`, and with them all signal features, are the same for every agent, bit for bit here: the sums run over the
//! signals and then over the number in closed form. Second, the number's entries are no longer 1 and 0 but
//! `(1 - m) / s` and `-m / s`; they move with the state, and because they carry `m` and `s`, standardising loses
//! nothing. They stay declared as `Identity`, so densities leave them out.

use crate::config::{ObservationConfig, ObservationMode, ObservationNorm};
use crate::description::{Feature, FeatureRole};

/// Below this deviation a vector counts as constant and is only centred.
const SMALLEST_DEVIATION: f64 = 1e-8;

/// The layout of a task's observations.
#[derive(Clone, Debug)]
pub(crate) struct Observation {
    mode: ObservationMode,
    norm: ObservationNorm,
    agents: usize,
}

impl Observation {
    pub(crate) fn new(config: &ObservationConfig, agents: usize) -> Self {
        Self { mode: config.mode, norm: config.norm, agents }
    }

    /// The features of any agent's observation, given the global state's names.
    pub(crate) fn features(&self, state: &[Feature]) -> Vec<Feature> {
        match self.mode {
            ObservationMode::FullId => {
                let number = (0..self.agents)
                    .map(|k| Feature { name: format!("id.{k}"), role: FeatureRole::Identity });
                state.iter().cloned().chain(number).collect()
            }
        }
    }

    /// Fills `out`, whose front already holds the global state in its first `out.len() - n` places.
    pub(crate) fn finish(&self, agent: usize, out: &mut [f32]) {
        let signals = out.len() - self.agents;
        out[signals..].fill(0.0);
        out[signals + agent] = 1.0;
        match self.norm {
            ObservationNorm::None => {}
            ObservationNorm::FeatureZ => standardise(out, signals),
        }
    }
}

/// `(x - m) / s` over all features; the one-hot part's sums are taken in closed form.
fn standardise(out: &mut [f32], signals: usize) {
    let count = out.len() as f64;
    let zeros = (out.len() - signals - 1) as f64;
    let sum: f64 = out[..signals].iter().map(|&x| f64::from(x)).sum();
    let mean = (sum + 1.0) / count;
    let squares: f64 = out[..signals].iter().map(|&x| square(f64::from(x) - mean)).sum();
    let variance = (squares + square(1.0 - mean) + zeros * square(mean)) / count;
    let deviation = variance.sqrt().max(SMALLEST_DEVIATION);
    for x in out {
        *x = ((f64::from(*x) - mean) / deviation) as f32;
    }
}

fn square(x: f64) -> f64 {
    x * x
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observe(norm: ObservationNorm, agent: usize) -> [f32; 5] {
        let config = ObservationConfig { mode: ObservationMode::FullId, norm };
        let mut out = [3.0, -1.0, 2.0, 9.0, 9.0];
        Observation::new(&config, 2).finish(agent, &mut out);
        out
    }

    #[test]
    fn without_scaling_the_state_and_the_number_stand_side_by_side() {
        assert_eq!(observe(ObservationNorm::None, 1), [3.0, -1.0, 2.0, 0.0, 1.0]);
    }

    #[test]
    fn a_vector_worked_by_hand_is_standardised_over_its_own_features() {
        // 3, -1, 2, 1, 0: mean 1, variance (4 + 4 + 1 + 0 + 1) / 5 = 2.
        let s = std::f32::consts::FRAC_1_SQRT_2;
        let expected = [2.0 * s, -2.0 * s, s, 0.0, -s];
        for (got, want) in observe(ObservationNorm::FeatureZ, 0).iter().zip(expected) {
            assert!((got - want).abs() < 1e-6);
        }
    }

    #[test]
    fn signals_are_the_same_bits_for_every_agent() {
        let (first, second) =
            (observe(ObservationNorm::FeatureZ, 0), observe(ObservationNorm::FeatureZ, 1));
        assert_eq!(first[..3], second[..3]);
        assert_eq!(first[3], second[4]);
    }
}
