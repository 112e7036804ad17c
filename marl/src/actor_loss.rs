//! Eq. (10): the actor's loss over the rows of a minibatch, and its gradient by the policy's mean
//! and sigma. Written by hand in f64, because it runs once per optimiser step over every row.

pub mod categorical;

use crate::gaussian;
use crate::influence::divergence::add_gradient;
use crate::influence::{Term, regularized_objective};
use crate::surrogate::{clipped_surrogate, is_held, ratio};

/// Weights of the loss's terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients {
    /// Half width of the ratio's trust region.
    pub clip: f64,
    /// Weight of the entropy bonus.
    pub entropy: f64,
    /// Weight of the influence term.
    pub lambda: f64,
    /// How the influence term is computed.
    pub term: Term,
}

/// What the loss needs to know about its rows and holds constant; `R` rows of `A` actions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// Actions taken, `[R, A]`.
    pub action: Vec<f64>,
    /// Log-densities of the actions under the behaviour weights, `[R]`.
    pub log_prob_old: Vec<f64>,
    /// Normalised advantages, `[R]`.
    pub advantage: Vec<f64>,
    /// Sequential factor `M`, `[R]`.
    pub factor: Vec<f64>,
    /// The posterior's mean `[R, A]` and sigma `[A]`; for choices its logits `[R, K]` and nothing. Empty without
    /// an influence term.
    pub posterior: (Vec<f64>, Vec<f64>),
}

/// The loss of some rows as their share of a minibatch, so that shares add up to the whole.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorLoss {
    /// Gradient of the loss by the policy's mean, `[R, A]`.
    pub d_mean: Vec<f64>,
    /// Gradient of the loss by the policy's sigma, `[A]`.
    pub d_sigma: Vec<f64>,
    /// What the rows add to the minibatch's figures.
    pub figures: Figures,
}

/// Figures of a minibatch. All are means over its rows, and shares of them add up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// The whole loss: what is minimised.
    pub loss: f64,
    /// Minus the weighted clipped surrogate.
    pub policy_loss: f64,
    /// Mean of `ratio - 1 - log ratio`, an estimate of `KL[old || new]`, nats.
    pub approx_kl: f64,
    /// Share of rows whose ratio is outside the trust region.
    pub clip_fraction: f64,
    /// Share of rows whose log-ratio is so far off that the ratio is held.
    pub held_fraction: f64,
    /// Mean influence term: the paper's is the capped `KL[q || p]`, nats.
    pub influence: f64,
    /// Share of rows whose divergence has reached its cap.
    pub capped_fraction: f64,
    /// Mean entropy of the policy, nats.
    pub entropy: f64,
}

impl Figures {
    /// Adds `weight` times `other`.
    pub fn add(&mut self, weight: f64, other: &Self) {
        self.loss += weight * other.loss;
        self.policy_loss += weight * other.policy_loss;
        self.approx_kl += weight * other.approx_kl;
        self.clip_fraction += weight * other.clip_fraction;
        self.held_fraction += weight * other.held_fraction;
        self.influence += weight * other.influence;
        self.capped_fraction += weight * other.capped_fraction;
        self.entropy += weight * other.entropy;
    }
}

/// Eq. (10): `-mean_R [ M min(ratio A, clip(ratio) A) + lambda min(KL[q || p], kappa act) ] -
/// c_entropy H[p]`, for rows that are `R` of the minibatch's `total` rows: every mean is divided by
/// `total`. `mean` is `[R, A]`, `sigma` is `[A]`.
#[must_use]
pub fn actor_loss(
    mean: &[f64],
    sigma: &[f64],
    rows: &Rows,
    total: usize,
    coefficients: &Coefficients,
) -> ActorLoss {
    let (width, share) = (sigma.len(), 1.0 / total as f64);
    let count = rows.advantage.len();
    let mut loss = ActorLoss {
        d_mean: vec![0.0; mean.len()],
        d_sigma: vec![0.0; width],
        figures: Figures::default(),
    };
    for row in 0..count {
        let of_row = row * width..(row + 1) * width;
        let p = (&mean[of_row.clone()], sigma);
        let gradient = (&mut loss.d_mean[of_row], loss.d_sigma.as_mut_slice());
        surrogate_row(row, p, rows, share, coefficients.clip, gradient, &mut loss.figures);
    }
    if !rows.posterior.1.is_empty() {
        influence_rows(mean, sigma, rows, share, coefficients, &mut loss);
    }
    entropy_bonus(sigma, count as f64 * share, coefficients.entropy, &mut loss);
    let Figures { policy_loss, influence, .. } = loss.figures;
    loss.figures.loss -= regularized_objective(-policy_loss, coefficients.lambda, influence);
    loss
}

fn surrogate_row(
    row: usize,
    p: (&[f64], &[f64]),
    rows: &Rows,
    share: f64,
    clip: f64,
    gradient: (&mut [f64], &mut [f64]),
    figures: &mut Figures,
) {
    let width = p.1.len();
    let action = &rows.action[row * width..(row + 1) * width];
    let log_prob = gaussian::log_prob(action, p.0, p.1);
    let slope = surrogate_slope(row, log_prob, rows, share, clip, figures);
    gaussian::add_log_prob_gradient(slope, action, p, gradient);
}

/// Counts one row's surrogate among the figures; the loss's slope by the row's new log-density.
fn surrogate_slope(
    row: usize,
    log_prob: f64,
    rows: &Rows,
    share: f64,
    clip: f64,
    figures: &mut Figures,
) -> f64 {
    let log_ratio = log_prob - rows.log_prob_old[row];
    let ratio_now = ratio(log_ratio, 0.0);
    let (value, slope) = clipped_surrogate(ratio_now, rows.advantage[row], clip);
    let weight = rows.factor[row] * share;
    // Beyond the guard the ratio is constant: its slope by the log-ratio is 0, not the ratio.
    let held = is_held(log_ratio);
    let ratio_slope = if held { 0.0 } else { ratio_now };
    figures.policy_loss -= weight * value;
    figures.approx_kl += share * (ratio_now - 1.0 - log_ratio);
    figures.clip_fraction += if (ratio_now - 1.0).abs() > clip { share } else { 0.0 };
    figures.held_fraction += if held { share } else { 0.0 };
    -weight * slope * ratio_slope
}

fn influence_rows(
    mean: &[f64],
    sigma: &[f64],
    rows: &Rows,
    share: f64,
    coefficients: &Coefficients,
    loss: &mut ActorLoss,
) {
    let width = sigma.len();
    for row in 0..rows.advantage.len() {
        let of_row = row * width..(row + 1) * width;
        let p = (&mean[of_row.clone()], sigma);
        let q = (&rows.posterior.0[of_row.clone()], rows.posterior.1.as_slice());
        let (value, slope) = coefficients.term.row(q, p);
        loss.figures.influence += share * value;
        loss.figures.capped_fraction += share * (1.0 - slope.abs());
        let gradient = (&mut loss.d_mean[of_row], loss.d_sigma.as_mut_slice());
        let weight = -coefficients.lambda * share * slope;
        add_gradient(coefficients.term.divergence, weight, q, p, gradient);
    }
}

fn entropy_bonus(sigma: &[f64], share: f64, weight: f64, loss: &mut ActorLoss) {
    loss.figures.entropy += share * gaussian::entropy(sigma);
    loss.figures.loss -= weight * share * gaussian::entropy(sigma);
    for (d_sigma, sigma) in loss.d_sigma.iter_mut().zip(sigma) {
        *d_sigma -= weight * share / sigma;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Divergence, Estimator};

    const TERM: Term =
        Term { estimator: Estimator::VariationalKl, divergence: Divergence::KlQp, kappa: 1.0 };
    const ALL: Coefficients = Coefficients { clip: 0.2, entropy: 0.03, lambda: 0.4, term: TERM };
    /// Means of three rows of two action dimensions, and the deviations.
    const MEAN: [f64; 6] = [0.1, -0.2, 0.4, 0.3, -0.5, 0.2];
    const SIGMA: [f64; 2] = [0.3, 0.45];

    fn rows() -> Rows {
        let action = vec![0.3, -0.1, 0.2, 0.9, -0.6, 0.0];
        let now = |row: usize| {
            let of_row = row * 2..row * 2 + 2;
            gaussian::log_prob(&action[of_row.clone()], &MEAN[of_row], &SIGMA)
        };
        // Ratios 1.1 (inside the trust region), 1.5 and 0.6 (outside, one free and one clipped).
        let ratios = [1.1, 1.5, 0.6];
        let log_prob_old = (0..3).map(|row| now(row) - libm::log(ratios[row])).collect();
        Rows {
            action,
            log_prob_old,
            advantage: vec![0.7, 1.2, 0.9],
            factor: vec![1.0, 1.3, 0.8],
            // The last row's divergence is far beyond the cap.
            posterior: (vec![0.2, 0.0, 0.3, 0.5, 2.5, 0.2], vec![0.25, 0.4]),
        }
    }

    #[test]
    fn the_loss_meets_a_hand_worked_case() {
        let loss = actor_loss(&MEAN, &SIGMA, &rows(), 3, &ALL).figures;
        // Row 2 is clipped at 1.2; row 3's ratio is below the region but its advantage is positive.
        let surrogate = (1.0 * 1.1 * 0.7 + 1.3 * 1.2 * 1.2 + 0.8 * 0.6 * 0.9) / 3.0;
        let divergence = |row: usize| {
            let (rows, of_row) = (rows(), row * 2..row * 2 + 2);
            let q = (&rows.posterior.0[of_row.clone()], rows.posterior.1.as_slice());
            gaussian::kl_divergence(q, (&MEAN[of_row], &SIGMA))
        };
        let influence = (divergence(0) + divergence(1) + 2.0) / 3.0; // the cap: 1 per dimension
        let by_hand = -surrogate - 0.4 * influence - 0.03 * gaussian::entropy(&SIGMA);
        assert!((loss.loss - by_hand).abs() < 1e-12, "{} {by_hand}", loss.loss);
        assert!((loss.clip_fraction - 2.0 / 3.0).abs() < 1e-12);
        assert!((loss.capped_fraction - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn the_gradient_meets_finite_differences() {
        let (cauchy_schwarz, kl_pq) = (Divergence::CauchySchwarz, Divergence::KlPq);
        gradient_meets_finite_differences(TERM);
        gradient_meets_finite_differences(Term { divergence: kl_pq, ..TERM });
        gradient_meets_finite_differences(Term { divergence: cauchy_schwarz, ..TERM });
        let estimator = Estimator::BarberAgakov;
        gradient_meets_finite_differences(Term { estimator, divergence: kl_pq, ..TERM });
    }

    fn gradient_meets_finite_differences(term: Term) {
        let all = Coefficients { term, ..ALL };
        let value =
            |mean: &[f64], sigma: &[f64]| actor_loss(mean, sigma, &rows(), 3, &all).figures.loss;
        let moved = |from: &[f64], at: usize, by: f64| {
            let mut to = from.to_vec();
            to[at] += by;
            to
        };
        let found = actor_loss(&MEAN, &SIGMA, &rows(), 3, &all);
        let h = 1e-6;
        let close = |up: f64, down: f64, found: f64| {
            let slope = (up - down) / (2.0 * h);
            assert!((slope - found).abs() < 1e-7 * (1.0 + slope.abs()), "{slope} {found}");
        };
        for at in 0..MEAN.len() {
            let (up, down) = (moved(&MEAN, at, h), moved(&MEAN, at, -h));
            close(value(&up, &SIGMA), value(&down, &SIGMA), found.d_mean[at]);
        }
        for at in 0..SIGMA.len() {
            let (up, down) = (moved(&SIGMA, at, h), moved(&SIGMA, at, -h));
            close(value(&MEAN, &up), value(&MEAN, &down), found.d_sigma[at]);
        }
    }

    #[test]
    fn shares_of_a_minibatch_add_up_to_it() {
        let (whole, all) = (actor_loss(&MEAN, &SIGMA, &rows(), 3, &ALL), rows());
        let part = |rows: std::ops::Range<usize>| {
            let wide = rows.start * 2..rows.end * 2;
            let own = Rows {
                action: all.action[wide.clone()].to_vec(),
                log_prob_old: all.log_prob_old[rows.clone()].to_vec(),
                advantage: all.advantage[rows.clone()].to_vec(),
                factor: all.factor[rows].to_vec(),
                posterior: (all.posterior.0[wide.clone()].to_vec(), all.posterior.1.clone()),
            };
            actor_loss(&MEAN[wide], &SIGMA, &own, 3, &ALL)
        };
        let (first, last) = (part(0..1), part(1..3));
        let together = [first.d_mean, last.d_mean].concat();
        assert!(together.iter().zip(&whole.d_mean).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!((first.figures.loss + last.figures.loss - whole.figures.loss).abs() < 1e-12);
        for at in 0..2 {
            assert!((first.d_sigma[at] + last.d_sigma[at] - whole.d_sigma[at]).abs() < 1e-12);
        }
    }

    #[test]
    fn without_a_posterior_there_is_no_influence() {
        let rows = Rows { posterior: Default::default(), ..rows() };
        assert_eq!(actor_loss(&MEAN, &SIGMA, &rows, 3, &ALL).figures.influence, 0.0);
    }
}
