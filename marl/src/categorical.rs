//! One choice among a few, row by row in f64: log-probability, entropy, divergence (Eq. 6), and their gradients by
//! the logits. These are the formulas; tensors carry them to the networks' parameters.

use libm::{exp, log};

use crate::config::Divergence;
use crate::influence::divergence::categorical::divergence;

/// `log p_k = logit_k - log sum_j exp logit_j`, nats. `logits` is `[K]`, and so is the answer.
#[must_use]
pub fn log_softmax(logits: &[f64]) -> Vec<f64> {
    let total = log_sum_exp(logits);
    logits.iter().map(|&x| x - total).collect()
}

/// `log sum_j exp logit_j`, the largest set apart so that no exponential overflows. `logits` is `[K]`.
#[must_use]
pub fn log_sum_exp(logits: &[f64]) -> f64 {
    let largest = logits.iter().fold(f64::NEG_INFINITY, |most, &x| most.max(x));
    largest + log(logits.iter().map(|&x| exp(x - largest)).sum::<f64>())
}

/// `log p(choice)` of one row, nats. `logits` is `[K]`.
#[must_use]
pub fn log_prob(choice: usize, logits: &[f64]) -> f64 {
    log_softmax(logits)[choice]
}

/// Adds `weight` times the gradient of [`log_prob`] by the logits, `1[k = choice] - p_k`, to `d_logits` `[K]`.
pub fn add_log_prob_gradient(weight: f64, choice: usize, logits: &[f64], d_logits: &mut [f64]) {
    for (d_logit, log_p) in d_logits.iter_mut().zip(log_softmax(logits)) {
        *d_logit -= weight * exp(log_p);
    }
    d_logits[choice] += weight;
}

/// `H = - sum_k p_k log p_k`, nats. `logits` is `[K]`.
#[must_use]
pub fn entropy(logits: &[f64]) -> f64 {
    -log_softmax(logits).iter().map(|&log_p| exp(log_p) * log_p).sum::<f64>()
}

/// Adds `weight` times the gradient of [`entropy`] by the logits, `- p_k (log p_k + H)`, to `d_logits` `[K]`.
pub fn add_entropy_gradient(weight: f64, logits: &[f64], d_logits: &mut [f64]) {
    let entropy = entropy(logits);
    for (d_logit, log_p) in d_logits.iter_mut().zip(log_softmax(logits)) {
        *d_logit -= weight * exp(log_p) * (log_p + entropy);
    }
}

/// Eq. (6): `KL[q || p] = sum_k q_k (log q_k - log p_k)`, the divergence inside the mutual information for one
/// row of two distributions over `K` choices, both given by logits `[K]`; nats.
#[must_use]
pub fn kl_divergence(q: &[f64], p: &[f64]) -> f64 {
    let pairs = log_softmax(q).into_iter().zip(log_softmax(p));
    pairs.map(|(log_q, log_p)| exp(log_q) * (log_q - log_p)).sum()
}

/// Adds `weight` times the gradient of [`kl_divergence`] by `p`'s logits, `p_k - q_k`, to `d_logits` `[K]`; `q`
/// is a constant.
pub fn add_kl_gradient(weight: f64, q: &[f64], p: &[f64], d_logits: &mut [f64]) {
    let pairs = log_softmax(q).into_iter().zip(log_softmax(p));
    for (d_logit, (log_q, log_p)) in d_logits.iter_mut().zip(pairs) {
        *d_logit += weight * (exp(log_p) - exp(log_q));
    }
}

/// Eq. (8): one row of the influence term for a choice, `min(KL[q_xi(. | a^-i, s) || p(. | s)], kappa)`, nats, and
/// its slope by the divergence (0 at the cap), with `kind` for the divergence's kind: the paper's is `KlQp`. `q` and
/// `p` are logits `[K]`.
#[must_use]
pub fn capped_divergence(kind: Divergence, q: &[f64], p: &[f64], kappa: f64) -> (f64, f64) {
    let divergence = divergence(kind, q, p);
    // Written so that a divergence that is no number stays one, and is noticed.
    if divergence >= kappa { (kappa, 0.0) } else { (divergence, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Probabilities 1/2, 1/4, 1/4 and 1/4, 1/4, 1/2, each moved by a constant.
    fn pair() -> ([f64; 3], [f64; 3]) {
        let logits = |p: [f64; 3], by: f64| p.map(|p| log(p) + by);
        (logits([0.5, 0.25, 0.25], 3.0), logits([0.25, 0.25, 0.5], -2.0))
    }

    fn meets_differences(of: impl Fn(&[f64]) -> f64, at: &[f64], found: &[f64]) {
        for k in 0..at.len() {
            let moved = |by: f64| {
                let mut to = at.to_vec();
                to[k] += by;
                of(&to)
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((slope - found[k]).abs() < 1e-8, "{k}: {slope} {}", found[k]);
        }
    }

    #[test]
    fn a_case_worked_by_hand_is_met() {
        let (q, p) = pair();
        assert!((log_prob(2, &p) - log(0.5)).abs() < 1e-14);
        assert!((entropy(&q) - 1.5 * log(2.0)).abs() < 1e-14);
        // 1/2 log 2 + 0 - 1/4 log 2
        assert!((kl_divergence(&q, &p) - 0.25 * log(2.0)).abs() < 1e-14);
        assert!(kl_divergence(&q, &q).abs() < 1e-15);
        assert!((entropy(&[7.0; 5]) - log(5.0)).abs() < 1e-14);
    }

    #[test]
    fn the_gradients_meet_finite_differences() {
        let (q, p) = ([0.3, -1.2, 0.8], [-0.4, 0.9, 0.2]);
        let mut found = [0.0; 3];
        add_log_prob_gradient(2.0, 1, &p, &mut found);
        meets_differences(|p| 2.0 * log_prob(1, p), &p, &found);
        found = [0.0; 3];
        add_entropy_gradient(-3.0, &p, &mut found);
        meets_differences(|p| -3.0 * entropy(p), &p, &found);
        found = [0.0; 3];
        add_kl_gradient(0.5, &q, &p, &mut found);
        meets_differences(|p| 0.5 * kl_divergence(&q, p), &p, &found);
    }

    #[test]
    fn at_the_cap_the_divergence_of_choices_stands_still() {
        let (q, p) = pair();
        let capped = |q: &[f64], p: &[f64]| capped_divergence(Divergence::KlQp, q, p, 1.0);
        assert_eq!(capped(&q, &p), (kl_divergence(&q, &p), 1.0));
        assert_eq!(capped(&[40.0, 0.0], &[0.0, 40.0]), (1.0, 0.0));
    }

    #[test]
    fn choices_that_are_next_to_impossible_stay_numbers() {
        let (q, p) = ([900.0, 0.0, -900.0], [-900.0, 0.0, 900.0]);
        assert!(entropy(&q).is_finite() && kl_divergence(&q, &p).is_finite());
        assert!(log_prob(2, &q).is_finite());
    }
}
