//! How far two diagonal Gaussians are from one another, in each of the configured senses, with
//! gradients by either side. A Gaussian is `(mean, sigma)`, both `[A]`; a row of the influence term.

pub mod categorical;

use libm::log;

use crate::config::Divergence;
use crate::gaussian::{add_kl_gradient, kl_divergence};

/// Mean and sigma of one row, or a gradient by them.
type Row<'a> = (&'a [f64], &'a [f64]);
type Gradient<'a> = (&'a mut [f64], &'a mut [f64]);

/// `D[q, p]` of the given kind, nats.
#[must_use]
pub fn divergence(kind: Divergence, q: Row<'_>, p: Row<'_>) -> f64 {
    match kind {
        Divergence::KlQp => kl_divergence(q, p),
        Divergence::KlPq => kl_divergence(p, q),
        Divergence::CauchySchwarz => cauchy_schwarz(q, p),
    }
}

/// Adds `weight` times the gradient of [`divergence`] by `p`'s mean and sigma; `q` is a constant.
pub fn add_gradient(kind: Divergence, weight: f64, q: Row<'_>, p: Row<'_>, to: Gradient<'_>) {
    match kind {
        Divergence::KlQp => add_kl_gradient(weight, q, p, to),
        Divergence::KlPq => add_kl_gradient_by_first(weight, p, q, to),
        Divergence::CauchySchwarz => add_cauchy_schwarz_gradient(weight, q, p, to),
    }
}

/// Adds `weight` times the gradient of [`divergence`] by `q`'s mean and sigma; `p` is a constant.
pub fn add_gradient_by_posterior(
    kind: Divergence,
    weight: f64,
    q: Row<'_>,
    p: Row<'_>,
    to: Gradient<'_>,
) {
    match kind {
        Divergence::KlQp => add_kl_gradient_by_first(weight, q, p, to),
        Divergence::KlPq => add_kl_gradient(weight, p, q, to),
        Divergence::CauchySchwarz => add_cauchy_schwarz_gradient(weight, p, q, to),
    }
}

/// `KL[x || y]`'s gradient by `x`: `(mu_x - mu_y) / sigma_y^2` and `sigma_x / sigma_y^2 - 1 / sigma_x`.
fn add_kl_gradient_by_first(weight: f64, x: Row<'_>, y: Row<'_>, (d_mean, d_sigma): Gradient<'_>) {
    for i in 0..x.0.len() {
        let variance = y.1[i] * y.1[i];
        d_mean[i] += weight * (x.0[i] - y.0[i]) / variance;
        d_sigma[i] += weight * (x.1[i] / variance - 1.0 / x.1[i]);
    }
}

/// `-log((int q p)^2 / (int q^2 int p^2)) = sum_d (mu_q - mu_p)^2 / v + log(v / (2 sigma_q sigma_p))`
/// with `v = sigma_q^2 + sigma_p^2`, nats.
fn cauchy_schwarz(q: Row<'_>, p: Row<'_>) -> f64 {
    let mut total = 0.0;
    for i in 0..p.0.len() {
        let (distance, variance) = (q.0[i] - p.0[i], q.1[i] * q.1[i] + p.1[i] * p.1[i]);
        total += distance * distance / variance + log(variance / (2.0 * q.1[i] * p.1[i]));
    }
    total
}

fn add_cauchy_schwarz_gradient(
    weight: f64,
    q: Row<'_>,
    p: Row<'_>,
    (d_mean, d_sigma): Gradient<'_>,
) {
    for i in 0..p.0.len() {
        let (distance, variance) = (p.0[i] - q.0[i], q.1[i] * q.1[i] + p.1[i] * p.1[i]);
        d_mean[i] += weight * 2.0 * distance / variance;
        let share = distance * distance / variance;
        d_sigma[i] += weight * (2.0 * p.1[i] * (1.0 - share) / variance - 1.0 / p.1[i]);
    }
}

#[cfg(test)]
mod tests {
    use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

    use super::*;
    use crate::gaussian::log_prob;

    const KINDS: [Divergence; 3] = [Divergence::KlQp, Divergence::KlPq, Divergence::CauchySchwarz];
    const Q: Row<'_> = (&[0.3, -0.2], &[0.4, 0.25]);
    const P: Row<'_> = (&[0.1, 0.5], &[0.3, 0.5]);

    /// Mean of `value` over rows drawn from `of`.
    fn mean_over(of: Row<'_>, value: impl Fn(&[f64]) -> f64) -> f64 {
        const ROWS: usize = 200_000;
        let mut rng = generator(RunSeed(8), Draw::of(Purpose::Probe));
        let mut row = || -> Vec<f64> {
            let draw = |(mean, sigma)| mean + sigma * f64::from(standard_normal(&mut rng));
            of.0.iter().zip(of.1).map(draw).collect()
        };
        (0..ROWS).map(|_| value(&row())).sum::<f64>() / ROWS as f64
    }

    #[test]
    fn the_closed_forms_meet_monte_carlo() {
        let difference = |x: &[f64]| log_prob(x, Q.0, Q.1) - log_prob(x, P.0, P.1);
        let density = |of: Row<'_>, x: &[f64]| libm::exp(log_prob(x, of.0, of.1));
        let (q_p, q_q, p_p) = (
            mean_over(Q, |x| density(P, x)),
            mean_over(Q, |x| density(Q, x)),
            mean_over(P, |x| density(P, x)),
        );
        let sampled = [mean_over(Q, difference), -mean_over(P, difference)];
        let found = KINDS.map(|kind| divergence(kind, Q, P));
        assert!((found[0] - sampled[0]).abs() < 0.01, "{found:?} {sampled:?}");
        assert!((found[1] - sampled[1]).abs() < 0.02, "{found:?} {sampled:?}");
        assert!((found[2] + log(q_p * q_p / (q_q * p_p))).abs() < 0.02, "{found:?}");
    }

    #[test]
    fn nothing_diverges_from_itself_and_only_cauchy_schwarz_is_symmetric() {
        for kind in KINDS {
            assert!(divergence(kind, P, P).abs() < 1e-12);
        }
        let both = |kind| (divergence(kind, Q, P), divergence(kind, P, Q));
        let (there, back) = both(Divergence::CauchySchwarz);
        assert!((there - back).abs() < 1e-12);
        assert_eq!(both(Divergence::KlQp).0, both(Divergence::KlPq).1);
        assert!((both(Divergence::KlQp).0 - both(Divergence::KlQp).1).abs() > 0.1);
    }

    #[test]
    fn gradients_by_either_side_meet_finite_differences() {
        let moved = |from: &[f64], at: usize, by: f64| {
            let mut to = from.to_vec();
            to[at] += by;
            to
        };
        type Value<'a> = &'a dyn Fn(&[f64], &[f64]) -> f64;
        let check = |value: Value<'_>, at: Row<'_>, found: ([f64; 2], [f64; 2])| {
            let h = 1e-6;
            for i in 0..2 {
                let by_mean = value(&moved(at.0, i, h), at.1) - value(&moved(at.0, i, -h), at.1);
                let by_sigma = value(at.0, &moved(at.1, i, h)) - value(at.0, &moved(at.1, i, -h));
                assert!((by_mean / (2.0 * h) - 1.3 * found.0[i]).abs() < 1e-6);
                assert!((by_sigma / (2.0 * h) - 1.3 * found.1[i]).abs() < 1e-6);
            }
        };
        for kind in KINDS {
            let (mut of_p, mut of_q) = (([0.0; 2], [0.0; 2]), ([0.0; 2], [0.0; 2]));
            add_gradient(kind, 1.0, Q, P, (&mut of_p.0, &mut of_p.1));
            add_gradient_by_posterior(kind, 1.0, Q, P, (&mut of_q.0, &mut of_q.1));
            check(&|mean, sigma| 1.3 * divergence(kind, Q, (mean, sigma)), P, of_p);
            check(&|mean, sigma| 1.3 * divergence(kind, (mean, sigma), P), Q, of_q);
        }
    }
}
