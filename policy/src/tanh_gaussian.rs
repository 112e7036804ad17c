//! The tanh-Gaussian distribution of continuous actions in a range: `middle + half tanh(u)` with a Gaussian `u`.
//!
//! The network's output `[2 A]` has the means `m` of `u`, then `l` with `log sigma = -5 + 3.5 (tanh(l) + 1)`. Both depend
//! on the observation. Computed in f64, so that an action gives back its `u` as well as its single precision allows.
//! Given the signal of noise that agents share, the means are shifted and `sigma` is multiplied by `own` `[A]`, else 1.

use core::f64::consts::LN_2;

use rand::RngCore;

use crate::gaussian::HALF_LOG_TWO_PI;
use crate::randomness::standard_normal;

/// Log-densities take tanh(u) from here on, `1 - 2^-20`, as the edge of the range: between numbers of single precision
/// that are closer to 1, `u` changes by more than a small sigma.
const EDGE: f64 = 1.0 - 1.0 / 1_048_576.0;

/// `log sigma` of the network's output `l`, between -5 and 2.
#[must_use]
pub fn log_sigma(l: f64) -> f64 {
    -5.0 + 3.5 * (libm::tanh(l) + 1.0)
}

/// The derivative of [`log_sigma`] by `l`.
#[must_use]
pub fn log_sigma_slope(l: f64) -> f64 {
    let tangent = libm::tanh(l);
    3.5 * (1.0 - tangent * tangent)
}

/// `sigma` of the network's output `l`.
#[must_use]
pub fn sigma(l: f32) -> f64 {
    libm::exp(log_sigma(f64::from(l)))
}

/// The action of `u` in the range `low` to `high`.
fn squashed(u: f64, (low, high): (f32, f32)) -> f32 {
    let (half, middle) = half_and_middle((low, high));
    ((middle + half * libm::tanh(u)) as f32).clamp(low, high)
}

/// Half the width of a range, and its middle.
fn half_and_middle((low, high): (f32, f32)) -> (f64, f64) {
    let (low, high) = (f64::from(low), f64::from(high));
    (0.5 * (high - low), 0.5 * (high + low))
}

/// Draws an action `[A]` from one row's output `[2 A]`.
pub(crate) fn draw(
    output: &[f32],
    (range, own): ((f32, f32), &[f64]),
    rng: &mut impl RngCore,
    action: &mut [f32],
) {
    let (means, ls) = output.split_at(action.len());
    for (((action, &mean), &l), own) in action.iter_mut().zip(means).zip(ls).zip(own) {
        let noise = sigma(l) * own * f64::from(standard_normal(rng));
        *action = squashed(f64::from(mean) + noise, range);
    }
}

/// The action `[A]` of the means of one row's output `[2 A]`.
pub(crate) fn mode(output: &[f32], range: (f32, f32), action: &mut [f32]) {
    for (action, &mean) in action.iter_mut().zip(output) {
        *action = squashed(f64::from(mean), range);
    }
}

/// Log-density of an action `[A]` under one row's output `[2 A]`, nats: `sum_d log N(u_d; m_d, sigma_d) - log |da/du|`.
/// An action at the edge of the range has many `u`; its density is that of the one closest to the mean, so it is finite.
#[must_use]
pub fn log_prob(output: &[f32], (range, own): ((f32, f32), &[f64]), action: &[f32]) -> f32 {
    let (half, middle) = half_and_middle(range);
    let (means, ls) = output.split_at(action.len());
    let one = |(((&mean, &l), &action), &own): (((&f32, &f32), &f32), &f64)| {
        let (mean, log_sigma) = (f64::from(mean), log_sigma(f64::from(l)) + libm::log(own));
        let value = (f64::from(action) - middle) / half;
        let nearest = libm::atanh(value.clamp(-EDGE, EDGE));
        let u = match value {
            _ if value >= EDGE => nearest.max(mean),
            _ if value <= -EDGE => nearest.min(mean),
            _ => nearest,
        };
        let z = (u - mean) / libm::exp(log_sigma);
        let gaussian = -0.5 * z * z - log_sigma - f64::from(HALF_LOG_TWO_PI);
        gaussian - libm::log(half) - log_slope(u)
    };
    means.iter().zip(ls).zip(action).zip(own).map(one).sum::<f64>() as f32
}

/// `log (1 - tanh(u)^2)`, also where tanh(u) rounds to 1: `2 (log 2 - |u| - log(1 + exp(-2 |u|)))`.
#[must_use]
pub fn log_slope(u: f64) -> f64 {
    let size = u.abs();
    2.0 * (LN_2 - size - libm::log1p(libm::exp(-2.0 * size)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::randomness::{Draw, Purpose, RunSeed, generator};

    const UNIT: (f32, f32) = (-1.0, 1.0);

    /// With independent noise.
    fn log_prob(output: &[f32], range: (f32, f32), action: &[f32]) -> f32 {
        super::log_prob(output, (range, &vec![1.0; action.len()]), action)
    }

    fn drawn(output: [f32; 2], range: (f32, f32), count: u32) -> Vec<f32> {
        let one = |step| {
            let mut action = [0.0];
            let mut rng = generator(RunSeed(1), Draw::of(Purpose::Probe).step(step));
            draw(&output, (range, &[1.0]), &mut rng, &mut action);
            action[0]
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn the_log_density_matches_a_hand_worked_case_in_every_range() {
        // l = 0: log sigma = -1.5. At the mean: 1.5 - .9189385 - log(1 - tanh(.5)^2) = .5810615 + .2402290
        let action = [libm::tanh(0.5) as f32];
        let found = log_prob(&[0.5, 0.0], UNIT, &action);
        assert!((found - 0.821_290_5).abs() < 1e-5, "{found}");
        // u = m + sigma / 2 costs 1/8 nat; 1 - tanh(m + sigma / 2)^2 changes with it.
        let u = 0.5 + 0.5 * libm::exp(-1.5);
        let found = log_prob(&[0.5, 0.0], UNIT, &[libm::tanh(u) as f32]);
        let expected = 0.581_061_5 - 0.125 - libm::log(1.0 - libm::tanh(u) * libm::tanh(u));
        assert!((f64::from(found) - expected).abs() < 1e-5, "{found} {expected}");
        // In a range of three times the width, densities are a third.
        let wide = log_prob(&[0.5, 0.0], (-2.0, 4.0), &[1.0 + 3.0 * action[0]]);
        assert!((wide - 0.821_290_5 + libm::logf(3.0)).abs() < 1e-5, "{wide}");
    }

    #[test]
    fn densities_add_up_to_one() {
        let count = 200_000;
        let density = |i: i32| {
            let action = (2.0 * f64::from(i) + 1.0) / f64::from(count) - 1.0;
            libm::exp(f64::from(log_prob(&[0.8, 0.2], UNIT, &[action as f32])))
        };
        let sum = 2.0 / f64::from(count) * (0..count).map(density).sum::<f64>();
        assert!((sum - 1.0).abs() < 1e-3, "{sum}");
    }

    #[test]
    fn the_bounds_have_finite_densities_and_agree_with_the_mean_beyond_them() {
        for mean in [-20.0_f32, -3.0, 0.0, 7.0, 20.0] {
            for action in [-1.0, 1.0] {
                assert!(log_prob(&[mean, -9.0], UNIT, &[action]).is_finite(), "{mean} {action}");
            }
        }
        // u = 20, the mean: 5 - .9189385 - 2 (log 2 - 20) = 42.694767
        for (mean, action) in [(20.0, 1.0), (-20.0, -1.0)] {
            let found = log_prob(&[mean, -20.0], UNIT, &[action]);
            assert!((found - 42.694_767).abs() < 1e-4, "{found}");
        }
    }

    #[test]
    fn actions_stay_in_the_range_and_their_u_has_the_distributions_moments() {
        // l = 0: sigma = exp(-1.5) = .2231302
        let actions = drawn([0.3, 0.0], (-2.0, 4.0), 20_000);
        let us = actions.iter().map(|&a| libm::atanh((f64::from(a) - 1.0) / 3.0));
        let (sum, squares) =
            us.fold((0.0, 0.0), |(sum, squares), u| (sum + u, squares + (u - 0.3) * (u - 0.3)));
        assert!((sum / 2e4 - 0.3).abs() < 0.008, "{sum}");
        assert!((libm::sqrt(squares / 2e4) - 0.223_13).abs() < 0.006, "{squares}");
        let saturated = drawn([30.0, 9.0], (-2.0, 4.0), 1000);
        assert!(saturated.iter().all(|a| (-2.0..=4.0).contains(a)) && saturated.contains(&4.0));
        let mut action = [0.0];
        mode(&[0.5, 0.0], (-2.0, 4.0), &mut action);
        assert!((action[0] - 2.386_351_5).abs() < 1e-5, "1 + 3 tanh(.5), {action:?}");
    }
}
