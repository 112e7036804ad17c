//! Gaussians whose noise all agents share in part (`policy::shared_noise`): the policy given the shared signal.

use std::borrow::Cow;

use super::HeadRows;
use crate::shape::assert_shape;

impl HeadRows {
    /// The policy given the signal `[R, K]` that the agents share: means `mu + sigma r z` and deviations
    /// `sigma sqrt(1 - |r|^2)`. With independent noise it is this one.
    ///
    /// # Panics
    /// If there is not one signal for every row.
    #[must_use]
    pub fn given(&self, signal: &[f64]) -> Cow<'_, Self> {
        let Some(size) = self.signal_size(signal) else { return Cow::Borrowed(self) };
        let act = self.sigma.len();
        let mut given = Self::gaussian(self.outputs.clone(), self.sigma.clone());
        for (means, z) in given.outputs.chunks_exact_mut(act).zip(signal.chunks_exact(size)) {
            for ((mean, r), sigma) in self.shifted(means).zip(&self.sigma) {
                *mean += sigma * dot(r, z);
            }
        }
        for (deviation, r) in self.shifted(&mut given.sigma) {
            *deviation *= libm::sqrt(1.0 - dot(r, r));
        }
        Cow::Owned(given)
    }

    /// Gradient with respect to these parameters, from the gradient `given` with respect to those of [`HeadRows::given`].
    ///
    /// # Panics
    /// If there is not one signal for every row.
    pub(crate) fn gradient_through(&self, given: Self, signal: &[f64]) -> Self {
        let Some(size) = self.signal_size(signal) else { return given };
        let act = self.sigma.len();
        // With respect to `sigma r`, `[act, K]`.
        let mut by_shift = vec![0.0; self.loading.len()];
        for (means, z) in given.outputs.chunks_exact(act).zip(signal.chunks_exact(size)) {
            for (mean, row) in means.iter().zip(by_shift.chunks_exact_mut(size)) {
                row.iter_mut().zip(z).for_each(|(slope, z)| *slope += mean * z);
            }
        }
        let mut gradient = Self { outputs: given.outputs, ..self.zeros() };
        for d in 0..act {
            let (r, by_shift) = (&self.loading[d * size..][..size], &by_shift[d * size..][..size]);
            let (sigma, rest) = (self.sigma[d], libm::sqrt(1.0 - dot(r, r)));
            gradient.sigma[d] = dot(by_shift, r) + given.sigma[d] * rest;
            for k in 0..size {
                let by_loading = sigma * by_shift[k] - given.sigma[d] * sigma * r[k] / rest;
                gradient.loading[d * size + k] = by_loading;
            }
        }
        gradient
    }

    /// `K`; `None` with independent noise.
    fn signal_size(&self, signal: &[f64]) -> Option<usize> {
        let size = self.loading.len() / self.sigma.len().max(1);
        assert_shape("signal", signal.len(), if size == 0 { 0 } else { self.count() * size });
        (size > 0).then_some(size)
    }

    /// Every number of `row` `[act]` with its loadings.
    fn shifted<'a>(&'a self, row: &'a mut [f64]) -> impl Iterator<Item = (&'a mut f64, &'a [f64])> {
        let size = self.loading.len() / self.sigma.len();
        row.iter_mut().zip(self.loading.chunks_exact(size))
    }
}

/// Inner product, summed in order.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rows of two actions that share a signal of two numbers.
    fn policy() -> HeadRows {
        let loading = vec![0.6, 0.0, 0.3, -0.4];
        HeadRows { loading, ..HeadRows::gaussian(vec![0.1, -0.2, 0.4, 0.3], vec![0.5, 0.2]) }
    }

    const SIGNAL: [f64; 4] = [1.0, 2.0, -0.5, 0.8];

    #[test]
    fn the_policy_given_the_signal_matches_a_worked_case() {
        let given = policy().given(&SIGNAL).into_owned();
        // 0.1 + 0.5 x 0.6 x 1; -0.2 + 0.2 (0.3 x 1 - 0.4 x 2); 0.4 - 0.5 x 0.6 x 0.5; 0.3 + 0.2 (-0.15 - 0.32)
        for (found, expected) in given.outputs.iter().zip([0.4, -0.3, 0.25, 0.206]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        // 0.5 sqrt(1 - 0.36) and 0.2 sqrt(1 - 0.25)
        assert!((given.sigma[0] - 0.4).abs() < 1e-12);
        assert!((given.sigma[1] - 0.173_205_080_756_887_7).abs() < 1e-12);
        assert!(given.loading.is_empty());
    }

    #[test]
    fn integrated_over_the_signal_two_agents_densities_are_their_joint_gaussian() {
        // r = 0.6 and 0.8, sigma = 1: covariance [[1, 0.48], [0.48, 1]], determinant 0.7696.
        let agent =
            |r: f64| HeadRows { loading: vec![r], ..HeadRows::gaussian(vec![0.0], vec![1.0]) };
        let (first, second, x, y) = (agent(0.6), agent(0.8), 0.3, -0.5);
        let integrand = |z: f64| {
            let log_prob = |agent: &HeadRows, a: f64| agent.given(&[z]).log_prob_of(0, &[a]);
            let prior = HeadRows::gaussian(vec![0.0], vec![1.0]).log_prob_of(0, &[z]);
            libm::exp(log_prob(&first, x) + log_prob(&second, y) + prior)
        };
        let step = 0.01;
        let found: f64 = (-800..=800).map(|k| integrand(f64::from(k) * step) * step).sum();
        let form = (x * x - 2.0 * 0.48 * x * y + y * y) / 0.7696;
        let expected = libm::exp(-0.5 * form) / (std::f64::consts::TAU * libm::sqrt(0.7696));
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }

    #[test]
    fn the_gradient_matches_finite_differences() {
        let (p, action) = (policy(), [0.3, -0.1, 0.2, 0.9]);
        let sum = |p: &HeadRows| p.given(&SIGNAL).log_prob(&action, &[0, 1]).iter().sum::<f64>();
        let mut given = HeadRows { loading: Vec::new(), ..p.zeros() };
        for row in 0..2 {
            let conditional = p.given(&SIGNAL);
            given.add_log_prob_gradient(1.0, row, &action[row * 2..][..2], &conditional);
        }
        let mut found = p.gradient_through(given, &SIGNAL);
        type Field = fn(&mut HeadRows) -> &mut Vec<f64>;
        let fields: [Field; 3] =
            [|rows| &mut rows.outputs, |rows| &mut rows.sigma, |rows| &mut rows.loading];
        for of in fields {
            for (at, found) in of(&mut found).clone().iter().enumerate() {
                let moved = |by: f64| {
                    let mut to = p.clone();
                    of(&mut to)[at] += by;
                    sum(&to)
                };
                let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!((slope - found).abs() < 1e-6 * (1.0 + slope.abs()), "{slope} {found}");
            }
        }
    }

    #[test]
    fn a_policy_with_independent_noise_is_itself_and_needs_no_signal() {
        let p = HeadRows::gaussian(vec![0.1], vec![0.2]);
        assert_eq!(p.given(&[]).as_ref(), &p);
        assert_eq!(p.gradient_through(p.clone(), &[]), p);
    }
}
