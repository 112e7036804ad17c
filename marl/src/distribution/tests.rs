//! Both kinds of distribution: cases worked by hand, limits, and gradients by finite differences.

use libm::log;

use super::*;

const Q: Row<'_> = Row { outputs: &[0.3, -0.2], sigma: &[0.4, 0.25] };
const P: Row<'_> = Row { outputs: &[0.1, 0.5], sigma: &[0.3, 0.5] };

fn logits(outputs: &[f64]) -> Row<'_> {
    Row { outputs, sigma: &[] }
}

#[test]
fn the_divergence_matches_a_worked_case() {
    // log(.3/.4) + (.16+.04)/.18 - .5 = .323429 ; log(.5/.25) + (.0625+.49)/.5 - .5 = 1.298147
    let found = GaussianRow.kl_divergence(Q, P);
    assert!((found - (0.323_429_038 + 1.298_147_181)).abs() < 1e-8);
}

#[test]
fn the_divergence_from_itself_is_zero_and_is_not_symmetric() {
    let (q, p) = ([2.0, 2.0], [log(0.25), log(0.75)]);
    let gaussian: (&dyn RowDistribution, _, _) = (&GaussianRow, Q, P);
    let categorical: (&dyn RowDistribution, _, _) = (&CategoricalRow, logits(&q), logits(&p));
    for (of, q, p) in [gaussian, categorical] {
        assert!(of.kl_divergence(q, q).abs() < 1e-15 && of.kl_divergence(p, p).abs() < 1e-15);
        let (there, back) = (of.kl_divergence(q, p), of.kl_divergence(p, q));
        assert!((there - back).abs() > 0.01, "{there} {back}");
    }
}

#[test]
fn the_entropy_is_minus_the_mean_log_density() {
    // E[z^2] = 1 in each dimension, so the mean log-density is that of z = 1 in all of them.
    let x = [P.outputs[0] + P.sigma[0], P.outputs[1] - P.sigma[1]];
    assert!((gaussian::entropy(P.sigma) + GaussianRow.log_prob(&x, P)).abs() < 1e-12);
}

#[test]
fn categorical_formulas_match_a_worked_case() {
    // Probabilities 1/2, 1/4, 1/4 and 1/4, 1/4, 1/2, each moved by a constant.
    let moved = |p: [f64; 3], by: f64| p.map(|p| log(p) + by);
    let (q, p) = (moved([0.5, 0.25, 0.25], 3.0), moved([0.25, 0.25, 0.5], -2.0));
    assert!((CategoricalRow.log_prob(&[2.0], logits(&p)) - log(0.5)).abs() < 1e-14);
    assert!((CategoricalRow.row_entropy(&q) - 1.5 * log(2.0)).abs() < 1e-14);
    // 1/2 log 2 + 0 - 1/4 log 2
    let found = CategoricalRow.kl_divergence(logits(&q), logits(&p));
    assert!((found - 0.25 * log(2.0)).abs() < 1e-14);
    assert!((CategoricalRow.row_entropy(&[7.0; 5]) - log(5.0)).abs() < 1e-14);
}

#[test]
fn categorical_distributions_without_overlap_have_large_divergences_and_finite_gradients() {
    let (q, p) = ([0.0, -700.0], [-700.0, 0.0]);
    let mut slopes = [0.0; 2];
    let gradient = RowGradient { outputs: &mut slopes, sigma: &mut [] };
    CategoricalRow.add_kl_gradient_by_p(1.0, logits(&q), logits(&p), gradient);
    let far = CategoricalRow.kl_divergence(logits(&q), logits(&p));
    assert!(far > 600.0 && far.is_finite(), "{far}");
    assert!(slopes.iter().all(|slope| slope.is_finite()), "{slopes:?}");
    let (q, p) = ([900.0, 0.0, -900.0], [-900.0, 0.0, 900.0]);
    assert!(CategoricalRow.row_entropy(&q).is_finite());
    assert!(CategoricalRow.kl_divergence(logits(&q), logits(&p)).is_finite());
    assert!(CategoricalRow.log_prob(&[2.0], logits(&q)).is_finite());
}

/// Compares the gradient that `add` gives at `at` with the finite differences of `value`.
fn meets_differences(
    at: Row<'_>,
    value: impl Fn(Row<'_>) -> f64,
    add: impl Fn(Row<'_>, RowGradient<'_>),
) {
    let width = at.outputs.len();
    let all = [at.outputs, at.sigma].concat();
    let of = |all: &[f64]| value(Row { outputs: &all[..width], sigma: &all[width..] });
    let mut found = vec![0.0; all.len()];
    let (outputs, sigma) = found.split_at_mut(width);
    add(at, RowGradient { outputs, sigma });
    for i in 0..all.len() {
        let moved = |by: f64| {
            let mut to = all.clone();
            to[i] += by;
            of(&to)
        };
        let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
        assert!((slope - found[i]).abs() < 1e-7 * (1.0 + slope.abs()), "{i}: {slope} {found:?}");
    }
}

#[test]
fn the_gradients_of_both_kinds_match_finite_differences() {
    let (q, p) = ([0.3, -1.2, 0.8], [-0.4, 0.9, 0.2]);
    let gaussian: (&dyn RowDistribution, _, _, &[f64]) = (&GaussianRow, Q, P, &[0.7, -0.1]);
    let categorical: (&dyn RowDistribution, _, _, &[f64]) =
        (&CategoricalRow, logits(&q), logits(&p), &[1.0]);
    for (of, q, p, action) in [gaussian, categorical] {
        meets_differences(
            p,
            |p| 2.0 * of.log_prob(action, p),
            |p, to| of.add_log_prob_gradient(2.0, action, p, to),
        );
        meets_differences(
            p,
            |p| -3.0 * of.row_entropy(p.outputs),
            |p, to| of.add_row_entropy_gradient(-3.0, p.outputs, to.outputs),
        );
        meets_differences(
            p,
            |p| 1.3 * of.kl_divergence(q, p),
            |p, to| of.add_kl_gradient_by_p(1.3, q, p, to),
        );
        meets_differences(
            q,
            |q| 1.3 * of.kl_divergence(q, p),
            |q, to| of.add_kl_gradient_by_q(1.3, q, p, to),
        );
    }
}
