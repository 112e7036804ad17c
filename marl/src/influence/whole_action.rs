//! Densities of actions of several numbers whose noise is correlated, for estimates of information.
//!
//! With noise that agents share, the numbers of one agent's action are correlated given the observation, because they have the same
//! signal. Given the others' actions, too, they are correlated, but less: these actions reveal a part of the signal. Products over the numbers would count the signal once for each of them.

use libm::log;

use super::exact::{log_determinant_and_inverse, of_one_plus, signal_precision, square};
use crate::distribution::HeadRows;

/// `log 2 pi`.
const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;

/// `log p(a)` of the rows `of`, nats, under the policy `p` with the covariance `sigma (1 - |r|^2 + r r^T) sigma` of its whole action.
/// `action` is `[R, act]`.
pub(crate) fn policy_log_prob(p: &HeadRows, action: &[f64], of: &[usize]) -> Vec<f64> {
    let act = p.action_size();
    let size = p.loading.len() / act;
    let rest: Vec<f64> = p.loading.chunks_exact(size).map(|r| 1.0 - square(r)).collect();
    let (log_signal, inverse) = of_one_plus(signal_precision(&p.loading, size), size);
    let logs = rest.iter().zip(&p.sigma).map(|(rest, sigma)| log(*rest) + 2.0 * log(*sigma));
    let constant = act as f64 * LOG_TWO_PI + logs.sum::<f64>() + log_signal;
    let row = |&row: &usize| {
        let x = deviations(p, row, action);
        let own: f64 = x.iter().zip(&rest).map(|(x, rest)| x * x / rest).sum();
        let mut signal = vec![0.0; size];
        for ((x, rest), r) in x.iter().zip(&rest).zip(p.loading.chunks_exact(size)) {
            signal.iter_mut().zip(r).for_each(|(sum, r)| *sum += r * x / rest);
        }
        -0.5 * (own - form(&signal, &inverse) + constant)
    };
    of.iter().map(row).collect()
}

/// `log q(a)` of the rows `of`, nats, under the posterior `q` with the covariance of its errors in the rows `trained`, which counts one
/// more row with the covariance of `q`, so that it has an inverse. `action` is `[R, act]`.
pub(crate) fn posterior_log_prob(
    q: &HeadRows,
    action: &[f64],
    trained: &[usize],
    of: &[usize],
) -> Vec<f64> {
    let act = q.action_size();
    let mut covariance = vec![0.0; act * act];
    (0..act).for_each(|d| covariance[d * act + d] = 1.0);
    for &row in trained {
        let x = deviations(q, row, action);
        let products = x.iter().flat_map(|a| x.iter().map(move |b| a * b));
        covariance.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
    }
    let share = 1.0 / (trained.len() + 1) as f64;
    covariance.iter_mut().for_each(|sum| *sum *= share);
    let (log_determinant, inverse) = log_determinant_and_inverse(covariance, act);
    let sigmas: f64 = q.sigma.iter().map(|sigma| 2.0 * log(*sigma)).sum();
    let constant = act as f64 * LOG_TWO_PI + sigmas + log_determinant;
    let row = |&row: &usize| -0.5 * (form(&deviations(q, row, action), &inverse) + constant);
    of.iter().map(row).collect()
}

/// An action's deviations from the mean of row `row`, `[act]`, in units of sigma.
fn deviations(rows: &HeadRows, row: usize, action: &[f64]) -> Vec<f64> {
    let parameters = rows.row(row);
    let action = &action[row * parameters.sigma.len()..];
    let pairs = action.iter().zip(parameters.outputs).zip(parameters.sigma);
    pairs.map(|((action, mean), sigma)| (action - mean) / sigma).collect()
}

/// `x^T m x`
fn form(x: &[f64], m: &[f64]) -> f64 {
    let rows = x.iter().zip(m.chunks_exact(x.len()));
    rows.map(|(a, row)| a * row.iter().zip(x).map(|(m, b)| m * b).sum::<f64>()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_match_a_correlated_gaussian_worked_by_hand() {
        // Loadings 0.6 and 0.8: correlation 0.48, determinant 0.7696.
        let p = HeadRows {
            loading: vec![0.6, 0.8],
            ..HeadRows::gaussian(vec![0.0, 0.0, 0.1, -0.2], vec![0.5, 2.0])
        };
        // Deviations 0.3 and -0.5 in units of sigma.
        let action = [0.0, 0.0, 0.25, -1.2];
        let form = (0.09 + 0.25 + 2.0 * 0.48 * 0.15) / 0.7696;
        let expected = -0.5 * (form + 2.0 * LOG_TWO_PI + log(0.7696));
        let found = policy_log_prob(&p, &action, &[1])[0];
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        // Three rows with deviations (1, 1), (1, -1) and (2, 0), and the own row: covariance [[7, 0], [0, 3]] / 4.
        let q = HeadRows::gaussian(vec![0.0; 6], vec![1.0, 1.0]);
        let action = [1.0, 1.0, 1.0, -1.0, 2.0, 0.0];
        let found = posterior_log_prob(&q, &action, &[0, 1, 2], &[0])[0];
        let form = 4.0 / 7.0 + 4.0 / 3.0;
        let expected = -0.5 * (form + 2.0 * LOG_TWO_PI + log(21.0 / 16.0));
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        let untrained = posterior_log_prob(&q, &action, &[], &[2])[0];
        assert!((untrained - q.log_prob_of(2, &[2.0, 0.0])).abs() < 1e-12, "{untrained}");
    }
}
