//! Social influence: the equations of section 3.3 of the paper, and the posteriors that estimate it.
//!
//! For policies with independent noise the true mutual information given `(o, h)` is 0. A posterior trained by maximum
//! likelihood on the actions taken therefore converges to the behaviour policy, and `KL[q || p]` rewards a policy for
//! moving away from it, up to the cap. `mutual_information` on held-out environments shows how near to 0 the estimate is.

pub(crate) mod count;
pub(crate) mod exact;
pub(crate) mod posterior;
pub(crate) mod second_head;
pub(crate) mod whole_action;

use crate::distribution::HeadRows;
use crate::shape::assert_shape;

/// Row `row` of the influence term: `capped_divergence` of the posterior `q` from the policy `p`.
#[must_use]
pub fn influence(row: usize, q: &HeadRows, p: &HeadRows, kappa: f64) -> (f64, f64) {
    let divergence = p.distribution().kl_divergence(q.row(row), p.row(row));
    capped_divergence(divergence, kappa, p.action_size())
}

/// `weight` times the gradient of the sum of [`influence`] over all rows with respect to the parameters of the posterior
/// `q`; the policy `p` is constant.
///
/// # Panics
/// If the shapes differ.
pub(crate) fn posterior_gradient(weight: f64, q: &HeadRows, p: &HeadRows, kappa: f64) -> HeadRows {
    q.assert_same_shape(p);
    let (distribution, mut gradient) = (q.distribution(), q.zeros());
    for row in 0..q.count() {
        let weight = weight * influence(row, q, p, kappa).1;
        let to = gradient.row_gradient(row);
        distribution.add_kl_gradient_by_q(weight, q.row(row), p.row(row), to);
    }
    gradient
}

/// Eq. (5): `J~ = J + lambda I`, an objective with the influence term. `influence` is in nats.
pub(crate) fn regularized_objective(objective: f64, lambda: f64, influence: f64) -> f64 {
    objective + lambda * influence
}

/// Eq. (6): `I = E[log p(a^i | a^-i, s) - log p(a^i | s)]`, its first line as a mean over rows, with `q_xi` as the
/// conditional. On rows that `q_xi` was not trained on it is a lower bound of the mutual information. Both slices are
/// `[R]`, nats; `None` without rows.
///
/// # Panics
/// If the shapes differ.
pub(crate) fn mutual_information(log_conditional: &[f64], log_marginal: &[f64]) -> Option<f64> {
    let count = log_conditional.len();
    assert_shape("log_marginal", log_marginal.len(), count);
    let difference = |(conditional, marginal): (&f64, &f64)| conditional - marginal;
    let sum: f64 = log_conditional.iter().zip(log_marginal).map(difference).sum();
    (count > 0).then(|| sum / count as f64)
}

/// Eq. (8): one row of the influence term, `min(KL[q_xi(. | a^-i, s) || p(. | s)], kappa act)`, nats, and its
/// derivative with respect to the divergence (0 at the cap). `dimensions` is `act`. Without the cap the divergence has
/// no upper bound.
pub(crate) fn capped_divergence(divergence: f64, kappa: f64, dimensions: usize) -> (f64, f64) {
    let cap = kappa * dimensions as f64;
    // This order of comparison keeps a NaN divergence, so that it is reported.
    if divergence >= cap { (cap, 0.0) } else { (divergence, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(mean: f64) -> HeadRows {
        HeadRows::gaussian(vec![mean, 0.0], vec![0.5, 0.5])
    }

    #[test]
    fn at_the_cap_the_divergence_is_constant() {
        assert_eq!(influence(0, &gaussian(0.5), &gaussian(0.0), 1.0), (0.5, 1.0));
        assert_eq!(influence(0, &gaussian(5.0), &gaussian(0.0), 1.0), (2.0, 0.0)); // KL = 50
    }

    #[test]
    fn at_the_cap_the_divergence_of_choices_is_constant() {
        let of = |logits: [f64; 2]| HeadRows::categorical(logits.to_vec(), 2);
        let (q, p) = (of([libm::log(3.0), 0.0]), of([0.0, 0.0]));
        let divergence = p.distribution().kl_divergence(q.row(0), p.row(0));
        assert_eq!(influence(0, &q, &p, 1.0), (divergence, 1.0));
        assert_eq!(influence(0, &of([40.0, 0.0]), &of([0.0, 40.0]), 1.0), (1.0, 0.0));
    }

    #[test]
    fn information_is_the_mean_gain_in_log_density() {
        assert_eq!(mutual_information(&[1.0, 2.0], &[0.5, 0.5]), Some(1.0));
        assert_eq!(mutual_information(&[], &[]), None);
    }

    #[test]
    fn the_objective_increases_by_lambda_times_the_influence() {
        assert_eq!(regularized_objective(2.0, 0.5, 3.0), 3.5);
    }
}
