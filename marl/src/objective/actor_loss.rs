//! Eq. (10): the actor's loss over the rows of a minibatch, and its gradient with respect to the policy's parameters.
//! The gradient is computed by hand in f64, because every optimiser step computes it for every row.

use super::surrogate::{clipped_surrogate, is_clamped, ratio};
use crate::distribution::{HeadRows, gaussian};
use crate::influence::exact::exact_information;
use crate::influence::{influence, regularized_objective};
use crate::shape::assert_shape;

/// Weights of the loss terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients {
    /// Half width of the interval to which the ratio is clipped.
    pub clip: f64,
    /// Weight of the entropy bonus.
    pub entropy: f64,
    /// Weight of the influence term.
    pub lambda: f64,
    /// Cap of the divergence in the influence term, nats per action dimension.
    pub kappa: f64,
}

/// Constants of the loss for `R` rows of `A` actions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// Actions taken, `[R, A]`.
    pub action: Vec<f64>,
    /// Log-probabilities of the actions under the behaviour weights, `[R]`.
    pub log_prob_old: Vec<f64>,
    /// Normalised advantages, `[R]`.
    pub advantage: Vec<f64>,
    /// Sequential factor `M`, `[R]`.
    pub factor: Vec<f64>,
    /// Posterior `q` of every row; `None` without an influence term.
    pub posterior: Option<HeadRows>,
    /// Signal of every row, `[R, K]`; empty with independent noise.
    pub signal: Vec<f64>,
    /// Precision that the other agents' actions add to the signal's, `[K, K]`; `None` unless influence is exact.
    pub others_precision: Option<Vec<f64>>,
}

/// Metrics of a minibatch. All are means over its rows; those of its parts add up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// The whole loss, which is minimised.
    pub loss: f64,
    /// Minus the weighted clipped surrogate.
    pub policy_loss: f64,
    /// Mean of `ratio - 1 - log ratio`, an estimate of `KL[old || new]`, nats.
    pub approx_kl: f64,
    /// Fraction of rows whose ratio is outside the clipping interval.
    pub clip_fraction: f64,
    /// Fraction of rows whose log-ratio is clamped.
    pub clamped_fraction: f64,
    /// Mean influence term, the capped `KL[q || p]` or the exact information, nats.
    pub influence: f64,
    /// Fraction of rows whose divergence is at its cap.
    pub capped_fraction: f64,
    /// Mean entropy of the policy, nats.
    pub entropy: f64,
    /// Sum of the magnitudes of the gradient with respect to the outputs of `p`, without the influence term; 0 without a
    /// posterior.
    pub gradient_without_influence: f64,
    /// As above, of the influence term alone.
    pub gradient_of_influence: f64,
}

impl Figures {
    /// The influence term's share of the gradient with respect to the outputs of `p`, both in magnitude.
    pub(crate) fn influence_share(&self) -> f64 {
        let all = self.gradient_without_influence + self.gradient_of_influence;
        if all > 0.0 { self.gradient_of_influence / all } else { 0.0 }
    }

    /// Adds `weight` times `other`.
    pub fn add(&mut self, weight: f64, other: &Self) {
        self.loss += weight * other.loss;
        self.policy_loss += weight * other.policy_loss;
        self.approx_kl += weight * other.approx_kl;
        self.clip_fraction += weight * other.clip_fraction;
        self.clamped_fraction += weight * other.clamped_fraction;
        self.influence += weight * other.influence;
        self.capped_fraction += weight * other.capped_fraction;
        self.entropy += weight * other.entropy;
        self.gradient_without_influence += weight * other.gradient_without_influence;
        self.gradient_of_influence += weight * other.gradient_of_influence;
    }
}

/// Eq. (10): `-mean_R [ M min(ratio A, clip(ratio) A) + lambda min(KL[q || p], kappa act) + c_entropy H[p] ]`, and its
/// gradient with respect to the parameters of `p`. The `R` rows are part of a minibatch of `total` rows. Every mean is
/// divided by `total`, so that the results of all parts add up. With noise that agents share, the ratio is that of the
/// policies given the signal; entropy and divergence are those of the policy without it. Exact influence (Eq. 5)
/// replaces the divergence.
///
/// # Panics
/// If the shapes of `p` and `rows` differ.
#[must_use]
pub fn actor_loss(
    p: &HeadRows,
    rows: &Rows,
    total: usize,
    coefficients: &Coefficients,
) -> (Figures, HeadRows) {
    rows.assert_shapes(p);
    let share = 1.0 / total as f64;
    let distribution = p.distribution();
    let width = p.action_size();
    let mut figures = Figures::default();
    let given = p.given(&rows.signal);
    let mut gradient = given.zeros();
    for row in 0..p.count() {
        let action = &rows.action[row * width..(row + 1) * width];
        let log_prob = distribution.log_prob(action, given.row(row));
        let slope = surrogate_slope(row, log_prob, rows, share, coefficients.clip, &mut figures);
        gradient.add_log_prob_gradient(slope, row, action, &given);
    }
    let mut gradient = p.gradient_through(gradient, &rows.signal);
    for row in 0..p.count() {
        let weight = -coefficients.entropy * share;
        let outputs = p.row(row).outputs;
        figures.entropy += share * distribution.row_entropy(outputs);
        let d_outputs = gradient.row_gradient(row).outputs;
        distribution.add_row_entropy_gradient(weight, outputs, d_outputs);
    }
    if let Some(q) = &rows.posterior {
        let before = gradient.outputs.clone();
        add_influence(p, q, share, coefficients, &mut figures, &mut gradient);
        let added = gradient.outputs.iter().zip(&before).map(|(after, before)| after - before);
        figures.gradient_of_influence = added.map(f64::abs).sum();
        figures.gradient_without_influence = before.iter().copied().map(f64::abs).sum();
    }
    let share = p.count() as f64 * share;
    if let Some(others) = &rows.others_precision {
        let size = p.loading.len() / width;
        let (information, slopes) = exact_information(&p.loading, others, size);
        figures.influence += share * information;
        let weight = coefficients.lambda * share;
        let to = gradient.loading.iter_mut().zip(&slopes);
        to.for_each(|(to, slope)| *to -= weight * slope);
    }
    figures.entropy += share * gaussian::entropy(&p.sigma);
    for (d_sigma, sigma) in gradient.sigma.iter_mut().zip(&p.sigma) {
        *d_sigma -= coefficients.entropy * share / sigma;
    }
    let Figures { policy_loss, influence, entropy, .. } = figures;
    figures.loss -= coefficients.entropy * entropy;
    figures.loss -= regularized_objective(-policy_loss, coefficients.lambda, influence);
    (figures, gradient)
}

impl Rows {
    fn assert_shapes(&self, p: &HeadRows) {
        let rows = p.count();
        assert_shape("action", self.action.len(), rows * p.action_size());
        assert_shape("log_prob_old", self.log_prob_old.len(), rows);
        assert_shape("advantage", self.advantage.len(), rows);
        assert_shape("factor", self.factor.len(), rows);
        self.posterior.iter().for_each(|q| p.assert_same_shape(q));
    }
}

/// Adds one row's surrogate to `figures`. Returns the derivative of the loss with respect to the row's new
/// log-probability.
fn surrogate_slope(
    row: usize,
    log_prob: f64,
    rows: &Rows,
    share: f64,
    clip: f64,
    figures: &mut Figures,
) -> f64 {
    let log_ratio = log_prob - rows.log_prob_old[row];
    let ratio_now = ratio(log_ratio);
    let (value, slope) = clipped_surrogate(ratio_now, rows.advantage[row], clip);
    let weight = rows.factor[row] * share;
    // A clamped ratio is constant: its derivative with respect to the log-ratio is 0, not the ratio.
    let clamped = is_clamped(log_ratio);
    let ratio_slope = if clamped { 0.0 } else { ratio_now };
    figures.policy_loss -= weight * value;
    figures.approx_kl += share * (ratio_now - 1.0 - log_ratio);
    figures.clip_fraction += if (ratio_now - 1.0).abs() > clip { share } else { 0.0 };
    figures.clamped_fraction += if clamped { share } else { 0.0 };
    -weight * slope * ratio_slope
}

/// Adds the influence term of all rows to `figures`, and its gradient with respect to `p` to `gradient`.
fn add_influence(
    p: &HeadRows,
    q: &HeadRows,
    share: f64,
    coefficients: &Coefficients,
    figures: &mut Figures,
    gradient: &mut HeadRows,
) {
    let Coefficients { lambda, kappa, .. } = *coefficients;
    for row in 0..p.count() {
        let (value, slope) = influence(row, q, p, kappa);
        figures.influence += share * value;
        figures.capped_fraction += share * (1.0 - slope);
        let weight = -lambda * share * slope;
        let to = gradient.row_gradient(row);
        p.distribution().add_kl_gradient_by_p(weight, q.row(row), p.row(row), to);
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use super::*;

    const ALL: Coefficients = Coefficients { clip: 0.2, entropy: 0.03, lambda: 0.4, kappa: 1.0 };

    /// Three rows of two action dimensions, and their data. The divergence of the last row exceeds the cap.
    fn gaussians() -> (HeadRows, Rows) {
        let p = HeadRows::gaussian(vec![0.1, -0.2, 0.4, 0.3, -0.5, 0.2], vec![0.3, 0.45]);
        let q = HeadRows::gaussian(vec![0.2, 0.0, 0.3, 0.5, 2.5, 0.2], vec![0.25, 0.4]);
        let rows = rows(&p, vec![0.3, -0.1, 0.2, 0.9, -0.6, 0.0], q);
        (p, rows)
    }

    /// As [`gaussians`], with three choices.
    fn choices() -> (HeadRows, Rows) {
        let p = HeadRows::categorical(vec![0.1, -0.2, 0.4, 0.3, -0.5, 0.2, 1.0, -2.0, 0.0], 3);
        let q = HeadRows::categorical(vec![0.2, 0.0, 0.3, 0.5, 0.9, 0.2, -3.0, 3.0, 0.0], 3);
        let rows = rows(&p, vec![0.0, 2.0, 1.0], q);
        (p, rows)
    }

    fn rows(p: &HeadRows, action: Vec<f64>, q: HeadRows) -> Rows {
        // Ratios 1.1 (inside the clipping interval), 1.5 and 0.6 (outside; the former is clipped, the latter is not).
        let now = p.log_prob(&action, &[0, 1, 2]).into_iter().zip([1.1, 1.5, 0.6]);
        Rows {
            action,
            log_prob_old: now.map(|(log_prob, ratio)| log_prob - libm::log(ratio)).collect(),
            advantage: vec![0.7, 1.2, 0.9],
            factor: vec![1.0, 1.3, 0.8],
            posterior: Some(q),
            ..Rows::default()
        }
    }

    /// The given rows only.
    fn part((p, all): &(HeadRows, Rows), of: Range<usize>) -> (HeadRows, Rows) {
        let (rows, width): (Vec<usize>, _) = (of.clone().collect(), p.action_size());
        let part = Rows {
            action: all.action[of.start * width..of.end * width].to_vec(),
            log_prob_old: all.log_prob_old[of.clone()].to_vec(),
            advantage: all.advantage[of.clone()].to_vec(),
            factor: all.factor[of].to_vec(),
            posterior: all.posterior.as_ref().map(|q| q.of_rows(&rows)),
            ..Rows::default()
        };
        (p.of_rows(&rows), part)
    }

    #[test]
    fn the_loss_matches_a_worked_case() {
        let p = choices().0;
        let entropy = (0..3).map(|row| p.distribution().row_entropy(p.row(row).outputs));
        // The cap is 1 per dimension.
        for ((p, rows), entropy, cap) in [
            (gaussians(), gaussian::entropy(&gaussians().0.sigma), 2.0),
            (choices(), entropy.sum::<f64>() / 3.0, 1.0),
        ] {
            let loss = actor_loss(&p, &rows, 3, &ALL).0;
            // Row 2 is clipped at 1.2. The ratio of row 3 is below the interval, but its advantage is positive.
            let surrogate = (1.0 * 1.1 * 0.7 + 1.3 * 1.2 * 1.2 + 0.8 * 0.6 * 0.9) / 3.0;
            let divergence = rows.posterior.unwrap().kl_divergences(&p);
            let influence = (divergence[0] + divergence[1] + cap) / 3.0;
            let by_hand = -surrogate - 0.4 * influence - 0.03 * entropy;
            assert!((loss.loss - by_hand).abs() < 1e-12, "{} {by_hand}", loss.loss);
            assert!((loss.clip_fraction - 2.0 / 3.0).abs() < 1e-12);
            assert!((loss.capped_fraction - 1.0 / 3.0).abs() < 1e-12);
        }
    }

    #[test]
    fn the_gradient_matches_finite_differences() {
        for (p, rows) in [gaussians(), choices(), sharing()] {
            let found = actor_loss(&p, &rows, 3, &ALL).1;
            let check = |of: fn(&mut HeadRows) -> &mut Vec<f64>| {
                for (at, found) in of(&mut found.clone()).iter().enumerate() {
                    let moved = |by: f64| {
                        let mut to = p.clone();
                        of(&mut to)[at] += by;
                        actor_loss(&to, &rows, 3, &ALL).0.loss
                    };
                    let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                    assert!((slope - found).abs() < 1e-7 * (1.0 + slope.abs()), "{slope} {found}");
                }
            };
            check(|rows| &mut rows.outputs);
            check(|rows| &mut rows.sigma);
            check(|rows| &mut rows.loading);
        }
    }

    /// As [`gaussians`], without a divergence, with a shared signal and exact influence.
    fn sharing() -> (HeadRows, Rows) {
        let (p, rows) = gaussians();
        let p = HeadRows { loading: vec![0.6, -0.3], ..p };
        let signal = vec![0.5, -1.0, 0.2];
        let now = p.given(&signal).log_prob(&rows.action, &[0, 1, 2]).into_iter();
        let log_prob_old = now.zip([1.1, 1.5, 0.6]).map(|(now, ratio)| now - libm::log(ratio));
        let (log_prob_old, others_precision) = (log_prob_old.collect(), Some(vec![0.9]));
        (p, Rows { log_prob_old, signal, others_precision, posterior: None, ..rows })
    }

    #[test]
    fn exact_influence_and_the_entropy_without_the_signal_are_those_of_a_worked_case() {
        let (p, rows) = sharing();
        let figures = actor_loss(&p, &rows, 3, &ALL).0;
        // P_i = 0.36 / 0.64 + 0.09 / 0.91, P_-i = 0.9.
        let own = 1.0 + 0.36 / 0.64 + 0.09 / 0.91;
        let information = 0.5 * libm::log(own * 1.9 / (own + 0.9));
        assert!((figures.influence - information).abs() < 1e-12, "{}", figures.influence);
        assert!((figures.entropy - gaussian::entropy(&p.sigma)).abs() < 1e-12);
        let terms = 0.4 * information + 0.03 * figures.entropy;
        assert!((figures.loss - (figures.policy_loss - terms)).abs() < 1e-12);
    }

    #[test]
    fn losses_of_parts_add_up_to_that_of_the_minibatch() {
        for all in [gaussians(), choices()] {
            let loss = |(p, rows): &(HeadRows, Rows)| actor_loss(p, rows, 3, &ALL);
            let whole = loss(&all);
            let (first, last) = (loss(&part(&all, 0..1)), loss(&part(&all, 1..3)));
            let together = [first.1.outputs, last.1.outputs].concat();
            assert!(together.iter().zip(&whole.1.outputs).all(|(a, b)| (a - b).abs() < 1e-12));
            assert!((first.0.loss + last.0.loss - whole.0.loss).abs() < 1e-12);
            for (at, sigma) in whole.1.sigma.iter().enumerate() {
                assert!((first.1.sigma[at] + last.1.sigma[at] - sigma).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_influences_share_of_the_gradient_matches_a_worked_case() {
        // The surrogate's gradient of -0.8 * (0.5 - 0.1) / 0.2^2 = -8; that of 0.4 KL[q || p] is 0.4 * (0.2 - 0.1) / 0.2^2 = 1.
        let (p, q) =
            (HeadRows::gaussian(vec![0.1], vec![0.2]), HeadRows::gaussian(vec![0.2], vec![0.2]));
        let rows = Rows {
            log_prob_old: p.log_prob(&[0.5], &[0]),
            action: vec![0.5],
            advantage: vec![0.8],
            factor: vec![1.0],
            posterior: Some(q),
            ..Rows::default()
        };
        let share = actor_loss(&p, &rows, 1, &ALL).0.influence_share();
        assert!((share - 1.0 / 9.0).abs() < 1e-12, "{share}");
    }

    #[test]
    fn without_a_posterior_the_influence_is_zero() {
        let (p, rows) = gaussians();
        let rows = Rows { posterior: None, ..rows };
        let figures = actor_loss(&p, &rows, 3, &ALL).0;
        assert_eq!((figures.influence, figures.influence_share()), (0.0, 0.0));
    }
}
