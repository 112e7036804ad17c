//! Social influence: what each equation of section 3.3 of the paper computes, and the posteriors
//! that estimate it.
//!
//! For decentralised policies the true mutual information given `(o, h)` is 0: agents draw their
//! noise independently. A posterior trained by maximum likelihood on the actions taken therefore
//! converges to the behaviour policy, and `KL[q || p]` rewards a policy for moving away from it, up
//! to the cap. `mutual_information` on held-out environments says how near to 0 the estimate is.

pub mod count;
pub mod divergence;
pub mod posterior;
pub mod second_head;

use crate::config::{Divergence, Estimator, InfluenceConfig};
use divergence::divergence;

use crate::categorical;

/// How one row of the influence term is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    /// What it estimates mutual information by.
    pub estimator: Estimator,
    /// The divergence in it.
    pub divergence: Divergence,
    /// Cap of a divergence that is climbed, nats per action dimension.
    pub kappa: f64,
}

impl Term {
    /// The term that `config` asks for.
    #[must_use]
    pub fn of(config: &InfluenceConfig) -> Self {
        let InfluenceConfig { estimator, divergence, kappa, .. } = *config;
        Self { estimator, divergence, kappa }
    }

    /// One row of the term, nats, and its slope by the divergence: Eq. (8)'s capped divergence, or
    /// Barber and Agakov's `E_p[log q + H[p]] = -KL[p || q]`. The latter is a lower bound of the
    /// information and needs no cap: it is at most 0, and highest where the policy is the posterior.
    /// `q` and `p` are `(mean, sigma)`, all `[act]`.
    #[must_use]
    pub fn row(&self, q: (&[f64], &[f64]), p: (&[f64], &[f64])) -> (f64, f64) {
        match self.estimator {
            Estimator::VariationalKl | Estimator::Count => {
                capped_divergence(self.divergence, q, p, self.kappa)
            }
            Estimator::BarberAgakov => (-divergence(self.divergence, q, p), -1.0),
        }
    }

    /// As [`Term::row`] for a choice; `q` and `p` are logits `[K]`.
    #[must_use]
    pub fn row_of_choices(&self, q: &[f64], p: &[f64]) -> (f64, f64) {
        match self.estimator {
            Estimator::VariationalKl | Estimator::Count => {
                categorical::capped_divergence(self.divergence, q, p, self.kappa)
            }
            Estimator::BarberAgakov => {
                (-divergence::categorical::divergence(self.divergence, q, p), -1.0)
            }
        }
    }
}

/// Eq. (5): `J~ = J + lambda I`, an objective with the influence term; nats and reward as they come.
#[must_use]
pub fn regularized_objective(objective: f64, lambda: f64, influence: f64) -> f64 {
    objective + lambda * influence
}

/// Eq. (6): `I = E[log p(a^i | a^-i, s) - log p(a^i | s)]`, its first line as a mean over rows, with
/// `q_xi` in the conditional's place: a lower bound of the mutual information on rows that `q_xi`
/// was not trained on. Both slices are `[R]`, nats; `None` of no rows.
#[must_use]
pub fn mutual_information(log_conditional: &[f64], log_marginal: &[f64]) -> Option<f64> {
    let count = log_conditional.len();
    let difference = |(conditional, marginal): (&f64, &f64)| conditional - marginal;
    let sum: f64 = log_conditional.iter().zip(log_marginal).map(difference).sum();
    (count > 0).then(|| sum / count as f64)
}

/// Eq. (8): one row of the influence term, `min(KL[q_xi(. | a^-i, s) || p(. | s)], kappa act)`, nats,
/// and its slope by the divergence (0 at the cap), with `kind` for the divergence's kind: the paper's
/// is `KlQp`. Without the cap the divergence has no upper end. `q` and `p` are `(mean, sigma)`, all
/// `[act]`.
#[must_use]
pub fn capped_divergence(
    kind: Divergence,
    q: (&[f64], &[f64]),
    p: (&[f64], &[f64]),
    kappa: f64,
) -> (f64, f64) {
    let divergence = divergence(kind, q, p);
    let cap = kappa * p.1.len() as f64;
    // Written so that a divergence that is no number stays one, and is noticed.
    if divergence >= cap { (cap, 0.0) } else { (divergence, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_the_cap_the_divergence_stands_still() {
        let p: (&[f64], &[f64]) = (&[0.0, 0.0], &[0.5, 0.5]);
        let near: (&[f64], &[f64]) = (&[0.5, 0.0], &[0.5, 0.5]); // KL = 1/2
        let far: (&[f64], &[f64]) = (&[5.0, 0.0], &[0.5, 0.5]); // KL = 50
        assert_eq!(capped_divergence(Divergence::KlQp, near, p, 1.0), (0.5, 1.0));
        assert_eq!(capped_divergence(Divergence::KlQp, far, p, 1.0), (2.0, 0.0));
    }

    #[test]
    fn barber_and_agakovs_bound_is_highest_where_the_policy_is_the_posterior() {
        let (estimator, divergence) = (Estimator::BarberAgakov, Divergence::KlPq);
        let term = Term { estimator, divergence, kappa: 1.0 };
        let p: (&[f64], &[f64]) = (&[0.0, 0.0], &[0.5, 0.5]);
        assert_eq!(term.row(p, p), (0.0, -1.0));
        assert_eq!(term.row((&[5.0, 0.0], &[0.5, 0.5]), p), (-50.0, -1.0));
    }

    #[test]
    fn information_is_the_mean_gain_in_log_density() {
        assert_eq!(mutual_information(&[1.0, 2.0], &[0.5, 0.5]), Some(1.0));
        assert_eq!(mutual_information(&[], &[]), None);
    }

    #[test]
    fn the_objective_gains_lambda_times_the_influence() {
        assert_eq!(regularized_objective(2.0, 0.5, 3.0), 3.5);
    }
}
