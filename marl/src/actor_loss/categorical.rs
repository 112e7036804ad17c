//! The actor's loss for choices, and its gradient by the logits.

use super::{Coefficients, Figures, Rows, surrogate_slope};
use crate::categorical;
use crate::influence::divergence::categorical::add_gradient;
use crate::influence::regularized_objective;

/// The loss of some rows as their share of a minibatch, so that shares add up to the whole.
#[derive(Clone, Debug, PartialEq)]
pub struct CategoricalLoss {
    /// Gradient of the loss by the policy's logits, `[R, K]`.
    pub d_logits: Vec<f64>,
    /// What the rows add to the minibatch's figures.
    pub figures: Figures,
}

/// Eq. (10) for choices: `-mean_R [ M min(ratio A, clip(ratio) A) + lambda min(KL[q || p], kappa) + c_entropy
/// H[p] ]`, for rows that are `R` of the minibatch's `total` rows. `logits` is `[R, K]` of `K = choices`, a
/// posterior's logits likewise.
#[must_use]
pub fn categorical_loss(
    logits: &[f64],
    choices: usize,
    rows: &Rows,
    total: usize,
    coefficients: &Coefficients,
) -> CategoricalLoss {
    let share = 1.0 / total as f64;
    let mut loss =
        CategoricalLoss { d_logits: vec![0.0; logits.len()], figures: Figures::default() };
    for row in 0..rows.advantage.len() {
        let of_row = row * choices..(row + 1) * choices;
        let (p, gradient) = (&logits[of_row.clone()], &mut loss.d_logits[of_row.clone()]);
        let choice = rows.action[row] as usize;
        let log_prob = categorical::log_prob(choice, p);
        let clip = coefficients.clip;
        let slope = surrogate_slope(row, log_prob, rows, share, clip, &mut loss.figures);
        categorical::add_log_prob_gradient(slope, choice, p, gradient);
        loss.figures.entropy += share * categorical::entropy(p);
        categorical::add_entropy_gradient(-coefficients.entropy * share, p, gradient);
        if !rows.posterior.0.is_empty() {
            let q = &rows.posterior.0[of_row];
            let (value, slope) = coefficients.term.row_of_choices(q, p);
            loss.figures.influence += share * value;
            loss.figures.capped_fraction += share * (1.0 - slope.abs());
            let weight = -coefficients.lambda * share * slope;
            add_gradient(coefficients.term.divergence, weight, q, p, gradient);
        }
    }
    let Figures { policy_loss, influence, entropy, .. } = loss.figures;
    loss.figures.loss -= coefficients.entropy * entropy;
    loss.figures.loss -= regularized_objective(-policy_loss, coefficients.lambda, influence);
    loss
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Divergence, Estimator};
    use crate::influence::Term;

    const ALL: Coefficients = Coefficients {
        clip: 0.2,
        entropy: 0.03,
        lambda: 0.4,
        term: Term {
            estimator: Estimator::VariationalKl,
            divergence: Divergence::KlQp,
            kappa: 0.8,
        },
    };
    /// Logits of three rows of three choices.
    const LOGITS: [f64; 9] = [0.1, -0.2, 0.4, 0.3, -0.5, 0.2, 1.0, -2.0, 0.0];

    fn rows() -> Rows {
        let action = vec![0.0, 2.0, 1.0];
        let now = |row: usize| categorical::log_prob(action[row] as usize, &LOGITS[row * 3..][..3]);
        // Ratios 1.1 (inside the trust region), 1.5 and 0.6 (outside, one free and one clipped).
        let ratios = [1.1, 1.5, 0.6];
        let log_prob_old = (0..3).map(|row| now(row) - libm::log(ratios[row])).collect();
        Rows {
            action,
            log_prob_old,
            advantage: vec![0.7, 1.2, 0.9],
            factor: vec![1.0, 1.3, 0.8],
            // The last row's divergence is beyond the cap.
            posterior: (vec![0.2, 0.0, 0.3, 0.5, 0.9, 0.2, -3.0, 3.0, 0.0], Vec::new()),
        }
    }

    #[test]
    fn the_loss_of_choices_meets_a_hand_worked_case() {
        let loss = categorical_loss(&LOGITS, 3, &rows(), 3, &ALL).figures;
        let surrogate = (1.0 * 1.1 * 0.7 + 1.3 * 1.2 * 1.2 + 0.8 * 0.6 * 0.9) / 3.0;
        let part = |row: usize| row * 3..row * 3 + 3;
        let divergence = |row: usize| {
            categorical::kl_divergence(&rows().posterior.0[part(row)], &LOGITS[part(row)])
        };
        let influence = (divergence(0) + divergence(1) + 0.8) / 3.0;
        let entropy = (0..3).map(|row| categorical::entropy(&LOGITS[part(row)])).sum::<f64>() / 3.0;
        let by_hand = -surrogate - 0.4 * influence - 0.03 * entropy;
        assert!((loss.loss - by_hand).abs() < 1e-12, "{} {by_hand}", loss.loss);
        assert!((loss.clip_fraction - 2.0 / 3.0).abs() < 1e-12);
        assert!((loss.capped_fraction - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn the_gradient_by_the_logits_meets_finite_differences() {
        let value = |logits: &[f64]| categorical_loss(logits, 3, &rows(), 3, &ALL).figures.loss;
        let found = categorical_loss(&LOGITS, 3, &rows(), 3, &ALL).d_logits;
        for at in 0..LOGITS.len() {
            let moved = |by: f64| {
                let mut to = LOGITS;
                to[at] += by;
                value(&to)
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((slope - found[at]).abs() < 1e-7, "{at}: {slope} {}", found[at]);
        }
    }

    #[test]
    fn shares_of_a_minibatch_of_choices_add_up_to_it() {
        let (whole, all) = (categorical_loss(&LOGITS, 3, &rows(), 3, &ALL), rows());
        let part = |range: std::ops::Range<usize>| {
            let wide = range.start * 3..range.end * 3;
            let own = Rows {
                action: all.action[range.clone()].to_vec(),
                log_prob_old: all.log_prob_old[range.clone()].to_vec(),
                advantage: all.advantage[range.clone()].to_vec(),
                factor: all.factor[range].to_vec(),
                posterior: (all.posterior.0[wide.clone()].to_vec(), Vec::new()),
            };
            categorical_loss(&LOGITS[wide], 3, &own, 3, &ALL)
        };
        let (first, last) = (part(0..1), part(1..3));
        let together = [first.d_logits, last.d_logits].concat();
        assert!(together.iter().zip(&whole.d_logits).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!((first.figures.loss + last.figures.loss - whole.figures.loss).abs() < 1e-12);
    }
}
