//! Diagonal Gaussians row by row in f64: log-density, entropy, divergence (Eq. 6), and their
//! gradients. These are the formulas; tensors carry them to the networks' parameters.

use libm::log;

/// `log 2 pi`.
pub const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;

/// `log N(x; mean, sigma)` of one row, nats. All slices are `[A]`.
#[must_use]
pub fn log_prob(x: &[f64], mean: &[f64], sigma: &[f64]) -> f64 {
    let mut total = 0.0;
    for ((x, mean), sigma) in x.iter().zip(mean).zip(sigma) {
        let z = (x - mean) / sigma;
        total -= 0.5 * z * z + log(*sigma) + 0.5 * LOG_TWO_PI;
    }
    total
}

/// Adds `weight` times the gradient of [`log_prob`] by `mean` and `sigma` to `d_mean` and `d_sigma`,
/// all `[A]`.
pub fn add_log_prob_gradient(
    weight: f64,
    x: &[f64],
    (mean, sigma): (&[f64], &[f64]),
    (d_mean, d_sigma): (&mut [f64], &mut [f64]),
) {
    for i in 0..x.len() {
        let z = (x[i] - mean[i]) / sigma[i];
        d_mean[i] += weight * z / sigma[i];
        d_sigma[i] += weight * (z * z - 1.0) / sigma[i];
    }
}

/// `H = sum_d (log sigma_d + 1/2 log 2 pi e)`, nats. `sigma` is `[A]`.
#[must_use]
pub fn entropy(sigma: &[f64]) -> f64 {
    sigma.iter().map(|&sigma| log(sigma) + 0.5 * (LOG_TWO_PI + 1.0)).sum()
}

/// Eq. (6): `KL[q || p] = sum_d log(sigma_p / sigma_q) + (sigma_q^2 + (mu_q - mu_p)^2) /
/// (2 sigma_p^2) - 1/2`, the divergence inside the mutual information in closed form for one row of
/// two diagonal Gaussians `(mean, sigma)`, all `[A]`; nats.
#[must_use]
pub fn kl_divergence(q: (&[f64], &[f64]), p: (&[f64], &[f64])) -> f64 {
    let mut total = 0.0;
    for i in 0..p.0.len() {
        let distance = q.0[i] - p.0[i];
        let (q_sigma, p_sigma) = (q.1[i], p.1[i]);
        let spread = (q_sigma * q_sigma + distance * distance) / (2.0 * p_sigma * p_sigma);
        total += log(p_sigma / q_sigma) + spread - 0.5;
    }
    total
}

/// Adds `weight` times the gradient of [`kl_divergence`] by `p`'s mean and sigma; `q` is a constant.
pub fn add_kl_gradient(
    weight: f64,
    q: (&[f64], &[f64]),
    p: (&[f64], &[f64]),
    (d_mean, d_sigma): (&mut [f64], &mut [f64]),
) {
    for i in 0..p.0.len() {
        let distance = p.0[i] - q.0[i];
        let (q_sigma, p_sigma) = (q.1[i], p.1[i]);
        let variance = p_sigma * p_sigma;
        d_mean[i] += weight * distance / variance;
        let spread = q_sigma * q_sigma + distance * distance;
        d_sigma[i] += weight * (1.0 - spread / variance) / p_sigma;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const Q: (&[f64], &[f64]) = (&[0.3, -0.2], &[0.4, 0.25]);
    const P: (&[f64], &[f64]) = (&[0.1, 0.5], &[0.3, 0.5]);

    #[test]
    fn the_divergence_meets_a_hand_worked_case() {
        // log(.3/.4) + (.16+.04)/.18 - .5 = .323429 ; log(.5/.25) + (.0625+.49)/.5 - .5 = 1.298147
        assert!((kl_divergence(Q, P) - (0.323_429_038 + 1.298_147_181)).abs() < 1e-8);
        assert!(kl_divergence(Q, Q).abs() < 1e-15);
    }

    #[test]
    fn the_entropy_is_minus_the_mean_log_density() {
        // E[z^2] = 1 in each dimension, so the mean log-density is that of z = 1 in all of them.
        let x = [P.0[0] + P.1[0], P.0[1] - P.1[1]];
        assert!((entropy(P.1) + log_prob(&x, P.0, P.1)).abs() < 1e-12);
    }

    #[test]
    fn gradients_meet_finite_differences() {
        let x = [0.7, -0.1];
        let value = |mean: &[f64], sigma: &[f64]| {
            0.7 * log_prob(&x, mean, sigma) + 1.3 * kl_divergence(Q, (mean, sigma))
        };
        let (mut d_mean, mut d_sigma) = ([0.0; 2], [0.0; 2]);
        add_log_prob_gradient(0.7, &x, P, (&mut d_mean, &mut d_sigma));
        add_kl_gradient(1.3, Q, P, (&mut d_mean, &mut d_sigma));
        for i in 0..2 {
            let moved = |by: f64, from: &[f64]| {
                let mut to = from.to_vec();
                to[i] += by;
                to
            };
            let h = 1e-6;
            let slope = |up: f64, down: f64| (up - down) / (2.0 * h);
            let by_mean = slope(value(&moved(h, P.0), P.1), value(&moved(-h, P.0), P.1));
            let by_sigma = slope(value(P.0, &moved(h, P.1)), value(P.0, &moved(-h, P.1)));
            assert!((by_mean - d_mean[i]).abs() < 1e-6 * (1.0 + by_mean.abs()));
            assert!((by_sigma - d_sigma[i]).abs() < 1e-6 * (1.0 + by_sigma.abs()));
        }
    }
}
