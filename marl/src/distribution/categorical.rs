//! Categorical distributions in f64. Outputs are logits; an action is the index of a choice.

use libm::{exp, log};

use super::{Row, RowDistribution, RowGradient};

/// `log p_k = logit_k - log sum_j exp logit_j`, nats. `logits` and the result are `[K]`.
fn log_softmax(logits: &[f64]) -> Vec<f64> {
    // Subtracting the largest prevents overflow.
    let largest = logits.iter().fold(f64::NEG_INFINITY, |most, &x| most.max(x));
    let total = largest + log(logits.iter().map(|&x| exp(x - largest)).sum::<f64>());
    logits.iter().map(|&x| x - total).collect()
}

/// Formulas of a categorical distribution.
#[derive(Clone, Copy, Debug)]
pub struct CategoricalRow;

impl RowDistribution for CategoricalRow {
    fn log_prob(&self, action: &[f64], p: Row<'_>) -> f64 {
        log_softmax(p.outputs)[action[0] as usize]
    }

    /// `1[k = choice] - p_k`.
    fn add_log_prob_gradient(
        &self,
        weight: f64,
        action: &[f64],
        p: Row<'_>,
        gradient: RowGradient<'_>,
    ) {
        for (d_logit, log_p) in gradient.outputs.iter_mut().zip(log_softmax(p.outputs)) {
            *d_logit -= weight * exp(log_p);
        }
        gradient.outputs[action[0] as usize] += weight;
    }

    /// `- sum_k p_k log p_k`.
    fn row_entropy(&self, logits: &[f64]) -> f64 {
        -log_softmax(logits).iter().map(|&log_p| exp(log_p) * log_p).sum::<f64>()
    }

    /// `- p_k (log p_k + H)`.
    fn add_row_entropy_gradient(&self, weight: f64, logits: &[f64], gradient: &mut [f64]) {
        let entropy = self.row_entropy(logits);
        for (d_logit, log_p) in gradient.iter_mut().zip(log_softmax(logits)) {
            *d_logit -= weight * exp(log_p) * (log_p + entropy);
        }
    }

    /// `sum_k q_k (log q_k - log p_k)`.
    fn kl_divergence(&self, q: Row<'_>, p: Row<'_>) -> f64 {
        let pairs = log_softmax(q.outputs).into_iter().zip(log_softmax(p.outputs));
        pairs.map(|(log_q, log_p)| exp(log_q) * (log_q - log_p)).sum()
    }

    /// `q_k (log q_k - log p_k - KL[q || p])`.
    fn add_kl_gradient_by_q(&self, weight: f64, q: Row<'_>, p: Row<'_>, gradient: RowGradient<'_>) {
        let whole = self.kl_divergence(q, p);
        let pairs = log_softmax(q.outputs).into_iter().zip(log_softmax(p.outputs));
        for (d_logit, (log_q, log_p)) in gradient.outputs.iter_mut().zip(pairs) {
            *d_logit += weight * exp(log_q) * (log_q - log_p - whole);
        }
    }

    /// `p_k - q_k`.
    fn add_kl_gradient_by_p(&self, weight: f64, q: Row<'_>, p: Row<'_>, gradient: RowGradient<'_>) {
        let pairs = log_softmax(q.outputs).into_iter().zip(log_softmax(p.outputs));
        for (d_logit, (log_q, log_p)) in gradient.outputs.iter_mut().zip(pairs) {
            *d_logit += weight * (exp(log_p) - exp(log_q));
        }
    }
}
