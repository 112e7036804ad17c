//! Diagonal Gaussians in f64. Outputs are means.

use libm::log;

use super::{Row, RowDistribution, RowGradient};

/// `log 2 pi`.
pub(crate) const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;

/// `H = sum_d (log sigma_d + 1/2 log 2 pi e)`, nats. `sigma` is `[act]`.
#[must_use]
pub fn entropy(sigma: &[f64]) -> f64 {
    sigma.iter().map(|&sigma| log(sigma) + 0.5 * (LOG_TWO_PI + 1.0)).sum()
}

/// Formulas of a diagonal Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct GaussianRow;

impl RowDistribution for GaussianRow {
    fn log_prob(&self, action: &[f64], p: Row<'_>) -> f64 {
        let mut total = 0.0;
        for ((x, mean), sigma) in action.iter().zip(p.outputs).zip(p.sigma) {
            let z = (x - mean) / sigma;
            total -= 0.5 * z * z + log(*sigma) + 0.5 * LOG_TWO_PI;
        }
        total
    }

    fn add_log_prob_gradient(
        &self,
        weight: f64,
        action: &[f64],
        p: Row<'_>,
        gradient: RowGradient<'_>,
    ) {
        for (i, x) in action.iter().enumerate() {
            let z = (x - p.outputs[i]) / p.sigma[i];
            gradient.outputs[i] += weight * z / p.sigma[i];
            gradient.sigma[i] += weight * (z * z - 1.0) / p.sigma[i];
        }
    }

    /// `sum_d log(sigma_p / sigma_q) + (sigma_q^2 + (mu_q - mu_p)^2) / (2 sigma_p^2) - 1/2`.
    fn kl_divergence(&self, q: Row<'_>, p: Row<'_>) -> f64 {
        let mut total = 0.0;
        for i in 0..p.outputs.len() {
            let distance = q.outputs[i] - p.outputs[i];
            let (q_sigma, p_sigma) = (q.sigma[i], p.sigma[i]);
            let spread = (q_sigma * q_sigma + distance * distance) / (2.0 * p_sigma * p_sigma);
            total += log(p_sigma / q_sigma) + spread - 0.5;
        }
        total
    }

    /// `(mu_q - mu_p) / sigma_p^2` and `sigma_q / sigma_p^2 - 1 / sigma_q`.
    fn add_kl_gradient_by_q(&self, weight: f64, q: Row<'_>, p: Row<'_>, gradient: RowGradient<'_>) {
        for i in 0..q.outputs.len() {
            let variance = p.sigma[i] * p.sigma[i];
            gradient.outputs[i] += weight * (q.outputs[i] - p.outputs[i]) / variance;
            gradient.sigma[i] += weight * (q.sigma[i] / variance - 1.0 / q.sigma[i]);
        }
    }

    fn add_kl_gradient_by_p(&self, weight: f64, q: Row<'_>, p: Row<'_>, gradient: RowGradient<'_>) {
        for i in 0..p.outputs.len() {
            let distance = p.outputs[i] - q.outputs[i];
            let (q_sigma, p_sigma) = (q.sigma[i], p.sigma[i]);
            let variance = p_sigma * p_sigma;
            gradient.outputs[i] += weight * distance / variance;
            let spread = q_sigma * q_sigma + distance * distance;
            gradient.sigma[i] += weight * (1.0 - spread / variance) / p_sigma;
        }
    }
}
