//! Eq. (5) with noise that agents share: the mutual information between their simultaneous actions in closed form.
//!
//! Given the observations, actions are jointly Gaussian with covariance `D + B B^T`, where `B = sigma r` and
//! `D = diag(sigma^2 (1 - |r|^2))` over all action dimensions. The information depends only on the loadings `r`.

use libm::log;

/// `sum_d r_d r_d^T / (1 - |r_d|^2)`, `[K, K]`: the precision that the actions with these loadings `[act, K]` add to that of
/// the signal, which is 1.
pub(super) fn signal_precision(loading: &[f64], size: usize) -> Vec<f64> {
    let mut sum = vec![0.0; size * size];
    for r in loading.chunks_exact(size) {
        let rest = 1.0 - square(r);
        for (at, element) in sum.iter_mut().enumerate() {
            *element += r[at / size] * r[at % size] / rest;
        }
    }
    sum
}

/// The sum of [`signal_precision`] over all agents but `agent`, `[K, K]`, from every agent's loadings `[act, K]`.
pub(crate) fn others_precision(agent: usize, loadings: &[&[f64]], size: usize) -> Vec<f64> {
    let mut sum = vec![0.0; size * size];
    for (_, other) in loadings.iter().enumerate().filter(|(index, _)| *index != agent) {
        let precision = signal_precision(other, size);
        sum.iter_mut().zip(precision).for_each(|(sum, one)| *sum += one);
    }
    sum
}

/// Eq. (5): `I(a^i; a^-i | o) = 1/2 (log det(1 + P_i) + log det(1 + P_-i) - log det(1 + P_i + P_-i))`, nats, with the
/// [`signal_precision`] `P_i` of the agent and `P_-i` of all others, `[K, K]`; and its gradient with respect to the agent's
/// loadings `[act, K]`. It equals `1/2 (log det Sigma_i + log det Sigma_-i - log det Sigma)` of the joint covariance.
pub(crate) fn exact_information(loading: &[f64], others: &[f64], size: usize) -> (f64, Vec<f64>) {
    let own = signal_precision(loading, size);
    let all: Vec<f64> = own.iter().zip(others).map(|(own, others)| own + others).collect();
    let (log_own, inverse_own) = of_one_plus(own, size);
    let (log_others, _) = of_one_plus(others.to_vec(), size);
    let (log_all, inverse_all) = of_one_plus(all, size);
    // 1/2 log det(1 + P) changes by 1/2 tr((1 + P)^-1 dP).
    let difference = |(own, all): (&f64, &f64)| own - all;
    let inverse: Vec<f64> = inverse_own.iter().zip(&inverse_all).map(difference).collect();
    let mut gradient = Vec::with_capacity(loading.len());
    for r in loading.chunks_exact(size) {
        let rest = 1.0 - square(r);
        let product = |row: &[f64]| row.iter().zip(r).map(|(a, b)| a * b).sum::<f64>();
        let turned: Vec<f64> = inverse.chunks_exact(size).map(product).collect();
        let form = product(&turned);
        gradient.extend(turned.iter().zip(r).map(|(t, r)| t / rest + form * r / (rest * rest)));
    }
    (0.5 * (log_own + log_others - log_all), gradient)
}

/// Logarithm of the determinant, and inverse, of `1 + m`, `[K, K]`.
pub(super) fn of_one_plus(mut m: Vec<f64>, size: usize) -> (f64, Vec<f64>) {
    (0..size).for_each(|k| m[k * size + k] += 1.0);
    log_determinant_and_inverse(m, size)
}

/// Logarithm of the determinant, and inverse, of `m`, `[size, size]`, by Gauss-Jordan elimination. A symmetric matrix with
/// eigenvalues above 0 needs no exchange of rows.
pub(super) fn log_determinant_and_inverse(mut m: Vec<f64>, size: usize) -> (f64, Vec<f64>) {
    let mut log_determinant = 0.0;
    for pivot in 0..size {
        let diagonal = m[pivot * size + pivot];
        log_determinant += log(diagonal);
        m[pivot * size + pivot] = 1.0;
        m[pivot * size..][..size].iter_mut().for_each(|x| *x /= diagonal);
        let scaled = m[pivot * size..][..size].to_vec();
        for row in (0..size).filter(|&row| row != pivot) {
            let factor = std::mem::replace(&mut m[row * size + pivot], 0.0);
            m[row * size..][..size].iter_mut().zip(&scaled).for_each(|(x, s)| *x -= factor * s);
        }
    }
    (log_determinant, m)
}

/// `|r|^2`
pub(crate) fn square(r: &[f64]) -> f64 {
    r.iter().map(|r| r * r).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_agents_with_one_action_each_share_minus_half_the_log_of_one_minus_the_squared_correlation()
     {
        for (own, other) in [(0.72, 0.72), (0.5, -0.9), (0.0, 0.8)] {
            let (found, slope) = exact_information(&[own], &signal_precision(&[other], 1), 1);
            let rest = 1.0 - own * own * other * other;
            assert!((found + 0.5 * log(rest)).abs() < 1e-12, "{found}");
            assert!((slope[0] - own * other * other / rest).abs() < 1e-12, "{}", slope[0]);
        }
    }

    #[test]
    fn three_agents_match_the_determinants_of_their_correlations() {
        // r = 0.5, 0.6, 0.8: correlations 0.3, 0.4 and 0.48 of actions 12, 13 and 23.
        let (found, _) = exact_information(&[0.5], &signal_precision(&[0.6, 0.8], 1), 1);
        let others = 1.0 - 0.48 * 0.48;
        let all = 1.0 + 2.0 * 0.3 * 0.4 * 0.48 - 0.3 * 0.3 - 0.4 * 0.4 - 0.48 * 0.48;
        assert!((found - 0.5 * log(others / all)).abs() < 1e-12, "{found}");
    }

    #[test]
    fn signals_without_a_common_agent_carry_no_information_and_others_do() {
        let (apart, _) = exact_information(&[0.7, 0.0], &signal_precision(&[0.0, 0.7], 2), 2);
        assert!(apart.abs() < 1e-12, "{apart}");
        // A signal in any direction is as good as one along an axis.
        let turned = exact_information(&[0.42, 0.56], &signal_precision(&[0.3, 0.4], 2), 2).0;
        let along = exact_information(&[0.7], &signal_precision(&[0.5], 1), 1).0;
        assert!((turned - along).abs() < 1e-12 && along > 0.05, "{turned} {along}");
    }

    #[test]
    fn the_gradient_matches_finite_differences() {
        let loading = [0.3, -0.5, 0.6, 0.2];
        let others = signal_precision(&[0.5, 0.5, -0.1, 0.8, 0.2, 0.0], 2);
        for (at, found) in exact_information(&loading, &others, 2).1.iter().enumerate() {
            let moved = |by: f64| {
                let mut to = loading;
                to[at] += by;
                exact_information(&to, &others, 2).0
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((slope - found).abs() < 1e-8, "{slope} {found}");
        }
    }
}
