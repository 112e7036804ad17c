//! How far two distributions over `K` choices are from one another, in each of the configured senses, with the
//! gradient by the policy's logits. Both are given by logits `[K]`; a row of the influence term.

use libm::exp;

use crate::categorical::{add_kl_gradient, kl_divergence, log_softmax, log_sum_exp};
use crate::config::Divergence;

/// `D[q, p]` of the given kind, nats.
#[must_use]
pub fn divergence(kind: Divergence, q: &[f64], p: &[f64]) -> f64 {
    match kind {
        Divergence::KlQp => kl_divergence(q, p),
        Divergence::KlPq => kl_divergence(p, q),
        Divergence::CauchySchwarz => cauchy_schwarz(q, p),
    }
}

/// Adds `weight` times the gradient of [`divergence`] by `p`'s logits to `d_logits` `[K]`; `q` is a constant.
pub fn add_gradient(kind: Divergence, weight: f64, q: &[f64], p: &[f64], d_logits: &mut [f64]) {
    match kind {
        Divergence::KlQp => add_kl_gradient(weight, q, p, d_logits),
        Divergence::KlPq => add_kl_gradient_by_first(weight, p, q, d_logits),
        Divergence::CauchySchwarz => add_cauchy_schwarz_gradient(weight, q, p, d_logits),
    }
}

/// `KL[x || y]`'s gradient by `x`'s logits: `x_k (log x_k - log y_k - KL[x || y])`.
fn add_kl_gradient_by_first(weight: f64, x: &[f64], y: &[f64], d_logits: &mut [f64]) {
    let whole = kl_divergence(x, y);
    let pairs = log_softmax(x).into_iter().zip(log_softmax(y));
    for (d_logit, (log_x, log_y)) in d_logits.iter_mut().zip(pairs) {
        *d_logit += weight * exp(log_x) * (log_x - log_y - whole);
    }
}

/// `-log((sum q p)^2 / (sum q^2 sum p^2))`, nats. Sums stand as logarithms, so that two distributions with nothing
/// in common are far apart and still a number.
fn cauchy_schwarz(q: &[f64], p: &[f64]) -> f64 {
    let (log_q, log_p) = (log_softmax(q), log_softmax(p));
    let overlap = |x: &[f64], y: &[f64]| log_sum_exp(&sum(x, y));
    overlap(&log_q, &log_q) + overlap(&log_p, &log_p) - 2.0 * overlap(&log_q, &log_p)
}

/// By `p`'s logits: `2 p_k^2 / sum p^2 - 2 q_k p_k / sum q p`.
fn add_cauchy_schwarz_gradient(weight: f64, q: &[f64], p: &[f64], d_logits: &mut [f64]) {
    let (log_q, log_p) = (log_softmax(q), log_softmax(p));
    let (own, shared) = (log_softmax(&sum(&log_p, &log_p)), log_softmax(&sum(&log_q, &log_p)));
    for (d_logit, (own, shared)) in d_logits.iter_mut().zip(own.into_iter().zip(shared)) {
        *d_logit += weight * 2.0 * (exp(own) - exp(shared));
    }
}

fn sum(x: &[f64], y: &[f64]) -> Vec<f64> {
    x.iter().zip(y).map(|(x, y)| x + y).collect()
}

#[cfg(test)]
mod tests {
    use libm::log;

    use super::*;

    const KINDS: [Divergence; 3] = [Divergence::KlQp, Divergence::KlPq, Divergence::CauchySchwarz];

    #[test]
    fn divergences_of_choices_meet_a_case_worked_by_hand() {
        // q = (1/2, 1/2), p = (1/4, 3/4), each moved by a constant.
        let (q, p) = ([2.0, 2.0], [log(0.25) - 1.0, log(0.75) - 1.0]);
        let found = KINDS.map(|kind| divergence(kind, &q, &p));
        // 1/2 log 2 + 1/2 log 2/3; 1/4 log 1/2 + 3/4 log 3/2; -log((1/2)^2 / (1/2 5/8)) = log 5/4
        let by_hand =
            [0.5 * log(2.0) + 0.5 * log(2.0 / 3.0), 0.25 * log(0.5) + 0.75 * log(1.5), log(1.25)];
        for (found, by_hand) in found.into_iter().zip(by_hand) {
            assert!((found - by_hand).abs() < 1e-14, "{found} {by_hand}");
        }
    }

    #[test]
    fn gradients_by_the_policys_logits_meet_finite_differences_in_every_sense() {
        let (q, p) = ([0.3, -1.2, 0.8], [-0.4, 0.9, 0.2]);
        for kind in KINDS {
            let mut found = [0.0; 3];
            add_gradient(kind, 1.5, &q, &p, &mut found);
            for k in 0..3 {
                let moved = |by: f64| {
                    let mut to = p;
                    to[k] += by;
                    1.5 * divergence(kind, &q, &to)
                };
                let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!((slope - found[k]).abs() < 1e-8, "{kind:?} {k}: {slope} {}", found[k]);
            }
        }
    }

    #[test]
    fn choices_with_nothing_in_common_are_far_apart_and_numbers() {
        let (q, p) = ([0.0, -700.0], [-700.0, 0.0]);
        for kind in KINDS {
            let mut gradient = [0.0; 2];
            add_gradient(kind, 1.0, &q, &p, &mut gradient);
            let far = divergence(kind, &q, &p);
            assert!(far > 600.0 && far.is_finite(), "{kind:?} {far}");
            assert!(gradient.iter().all(|slope| slope.is_finite()), "{kind:?} {gradient:?}");
        }
    }
}
