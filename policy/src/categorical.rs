//! The categorical distribution of a discrete action, given by logits.

use candle_core::Tensor;
use rand::RngCore;

/// A trainable categorical distribution over `R` rows of `K` choices.
#[derive(Clone, Debug)]
pub struct Categorical {
    /// Unnormalised log-probabilities, `[R, K]`.
    pub logits: Tensor,
}

/// `log p(choice) = logit_choice - log sum_k exp logit_k`, nats. `logits` is `[K]`. Computed in f64 to avoid
/// overflow and rounding errors.
#[must_use]
pub fn log_prob(logits: &[f32], choice: usize) -> f32 {
    let largest = f64::from(logits[mode(logits)]);
    let sum: f64 = logits.iter().map(|&x| libm::exp(f64::from(x) - largest)).sum();
    (f64::from(logits[choice]) - largest - libm::log(sum)) as f32
}

/// The likeliest choice; the first if several are equally likely.
#[must_use]
pub fn mode(logits: &[f32]) -> usize {
    let mut best = 0;
    for (choice, &logit) in logits.iter().enumerate() {
        if logit > logits[best] {
            best = choice;
        }
    }
    best
}

/// Draws a choice with one 32-bit number `u` in `[0, 1)`: the first whose cumulative weight exceeds `u` times the total.
/// The weights are `exp(logit - largest)` in f64, added in the order of the choices.
pub fn draw(logits: &[f32], rng: &mut impl RngCore) -> usize {
    let largest = f64::from(logits[mode(logits)]);
    let weight = |&logit: &f32| libm::exp(f64::from(logit) - largest);
    let total: f64 = logits.iter().map(weight).sum();
    let threshold = f64::from(rng.next_u32()) / 4_294_967_296.0 * total;
    let mut sum = 0.0;
    let exceeds = |logit: &f32| {
        sum += weight(logit);
        sum > threshold
    };
    // The threshold is below the total, so a choice is found. NaN logits are rejected elsewhere.
    logits.iter().position(exceeds).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::randomness::{Draw, Purpose, RunSeed, generator};

    /// Logits of the probabilities 1/2, 1/3 and 1/6, plus a constant.
    fn logits() -> [f32; 3] {
        [0.5, 1.0 / 3.0, 1.0 / 6.0].map(|p: f32| libm::logf(p) + 7.0)
    }

    #[test]
    fn the_log_probability_matches_a_hand_worked_case_at_every_scale() {
        for (choice, p) in [0.5, 1.0 / 3.0, 1.0 / 6.0].into_iter().enumerate() {
            assert!((f64::from(log_prob(&logits(), choice)) - libm::log(p)).abs() < 1e-6);
        }
        assert_eq!(log_prob(&[1e4, 0.0], 1), -1e4);
        assert_eq!(log_prob(&[-3e38, 0.0], 1), 0.0);
    }

    #[test]
    fn the_first_of_the_likeliest_is_the_mode() {
        assert_eq!(mode(&[0.1, -2.0, 0.7, 0.7]), 2);
        assert_eq!(mode(&[0.0, 0.0]), 0);
    }

    #[test]
    fn choices_are_drawn_in_proportion_to_their_probabilities() {
        let mut counts = [0_i32; 3];
        for step in 0..60_000 {
            let mut rng = generator(RunSeed(1), Draw::of(Purpose::Probe).step(step));
            counts[draw(&logits(), &mut rng)] += 1;
        }
        // Standard deviations are at most 122.
        let expected = [30_000, 20_000, 10_000];
        assert!(counts.iter().zip(expected).all(|(n, e)| (n - e).abs() < 500), "{counts:?}");
    }

    #[test]
    fn a_choice_without_weight_is_never_drawn() {
        let mut rng = generator(RunSeed(1), Draw::of(Purpose::Probe));
        assert!((0..1000).all(|_| draw(&[-1e9, 0.0, -1e9], &mut rng) == 1));
    }
}
