//! Actions drawn from tanh-Gaussian policies, with their log-probabilities and gradients.
//!
//! `u = m + sigma n`, `log sigma = -5 + 3.5 (tanh(l) + 1)`, action `middle + half tanh(u)`. Log-probabilities are those
//! of `tanh(u)`, computed from `u`: in the loss, an action at a bound keeps its exact density.

use policy::tanh_gaussian::{log_sigma, log_sigma_slope, log_slope};

/// `1/2 log 2 pi`.
const HALF_LOG_TWO_PI: f64 = 0.918_938_533_204_672_7;

/// Actions of `R` rows.
#[derive(Clone, Debug, Default)]
pub(super) struct DrawnActions {
    /// In the environment's units, `[R, act]`.
    pub(super) action: Vec<f32>,
    /// Log-probability of `tanh(u)`, `[R]`, nats.
    pub(super) log_prob: Vec<f64>,
    /// The standard normal `n` of every action, `[R, act]`.
    pub(super) noise: Vec<f32>,
    terms: Vec<Term>,
    half: f64,
}

/// What the gradient of one action dimension needs.
#[derive(Clone, Copy, Debug)]
struct Term {
    /// `tanh(u)`.
    tangent: f64,
    /// `sigma n`, the derivative of `u` by `log sigma`.
    reach: f64,
    sigma: f64,
    /// Derivative of `log sigma` by the network's output.
    slope: f64,
}

impl DrawnActions {
    /// Actions in `range` for the network's outputs `[R, 2 act]`, means and `l`, with standard normal `noise`
    /// `[R, act]`.
    pub(super) fn new(
        output: &[f32],
        noise: Vec<f32>,
        dimensions: usize,
        (low, high): (f32, f32),
    ) -> Self {
        let half = 0.5 * (f64::from(high) - f64::from(low));
        let middle = 0.5 * (f64::from(high) + f64::from(low));
        let mut drawn = Self { half, ..Self::default() };
        for (output, noise) in
            output.chunks_exact(2 * dimensions).zip(noise.chunks_exact(dimensions))
        {
            let (means, ls) = output.split_at(dimensions);
            let mut log_prob = 0.0;
            for ((&mean, &l), &noise) in means.iter().zip(ls).zip(noise) {
                let [mean, l, noise] = [mean, l, noise].map(f64::from);
                let log_sigma = log_sigma(l);
                let sigma = libm::exp(log_sigma);
                let reach = sigma * noise;
                let u = mean + reach;
                let tangent = libm::tanh(u);
                log_prob += -0.5 * noise * noise - log_sigma - HALF_LOG_TWO_PI - log_slope(u);
                let slope = log_sigma_slope(l);
                drawn.action.push(((middle + half * tangent) as f32).clamp(low, high));
                drawn.terms.push(Term { tangent, reach, sigma, slope });
            }
            drawn.log_prob.push(log_prob);
        }
        Self { noise, ..drawn }
    }

    /// Gradient of `mean(temperature log_prob - value)` with respect to every `u`, `[R, act]`, without the density of `n`.
    fn gradient_by_u(&self, temperature: f64, by_action: &[f32]) -> Vec<f64> {
        let share = 1.0 / self.log_prob.len() as f64;
        let by_u = |(term, &by_action): (&Term, &f32)| {
            let pull = f64::from(by_action) * self.half * (1.0 - term.tangent * term.tangent);
            share * (2.0 * temperature * term.tangent - pull)
        };
        self.terms.iter().zip(by_action).map(by_u).collect()
    }

    /// Gradient of `mean(temperature log_prob - value)` with respect to every `n`, `[R, act]`.
    pub(super) fn noise_gradient(&self, temperature: f64, by_action: &[f32]) -> Vec<f64> {
        let share = 1.0 / self.log_prob.len() as f64;
        let by_u = self.gradient_by_u(temperature, by_action);
        let pairs = by_u.iter().zip(&self.terms).zip(&self.noise);
        let one = |((by_u, term), &n): ((&f64, &Term), &f32)| {
            by_u * term.sigma - share * temperature * f64::from(n)
        };
        pairs.map(one).collect()
    }

    /// Gradient of `mean(temperature log_prob - value)` with respect to the network's outputs, `[R, 2 act]`. `by_action`
    /// `[R, act]` is the gradient of every row's value with respect to its action.
    pub(super) fn gradient(&self, temperature: f64, by_action: &[f32]) -> Vec<f32> {
        let rows = self.log_prob.len();
        let dimensions = self.action.len() / rows;
        let share = 1.0 / rows as f64;
        let by_u = self.gradient_by_u(temperature, by_action);
        let mut gradient = Vec::with_capacity(2 * self.action.len());
        for (terms, by_u) in self.terms.chunks_exact(dimensions).zip(by_u.chunks_exact(dimensions))
        {
            gradient.extend(by_u.iter().map(|&by_u| by_u as f32));
            let by_l = terms.iter().zip(by_u).map(|(term, by_u)| {
                ((by_u * term.reach - share * temperature) * term.slope) as f32
            });
            gradient.extend(by_l);
        }
        gradient
    }

    /// Mean of minus the log-probabilities, nats.
    pub(super) fn entropy(&self) -> f64 {
        -self.log_prob.iter().sum::<f64>() / self.log_prob.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_probabilities_are_exact_far_beyond_where_the_tangent_rounds_to_one() {
        // l = 0: log sigma = -1.5. eps = 0: 1.5 - .9189385 - log(1 - tanh(u)^2), with 2 (log 2 - 20) at u = 20.
        for mean in [20.0, -20.0] {
            let drawn = DrawnActions::new(&[mean, 0.0], vec![0.0], 1, (-1.0, 1.0));
            let expected = 1.5 - 0.918_938_533 + 40.0 - 2.0 * core::f64::consts::LN_2;
            assert!((drawn.log_prob[0] - expected).abs() < 1e-8, "{drawn:?}");
            assert_eq!(drawn.action, [mean.signum()]);
            assert!(drawn.gradient(1.0, &[3.0]).iter().all(|x| x.is_finite()));
        }
        // Two dimensions of a wider range: the sum of both, independent of the range.
        let drawn = DrawnActions::new(&[0.5, 0.0, 0.0, 0.0], vec![0.0, 2.0], 2, (-2.0, 4.0));
        let slope = |u: f64| libm::log(1.0 - libm::tanh(u) * libm::tanh(u));
        let second = 2.0 * libm::exp(-1.5);
        let expected = 2.0 * (1.5 - 0.918_938_533) - slope(0.5) - 2.0 - slope(second);
        assert!((drawn.log_prob[0] - expected).abs() < 1e-8, "{drawn:?} {expected}");
        assert!((f64::from(drawn.action[1]) - 1.0 - 3.0 * libm::tanh(second)).abs() < 1e-6);
    }

    #[test]
    fn gradients_meet_finite_differences_of_the_loss() {
        let output = [0.3, -0.8, 0.4, -0.2, -1.1, 0.6, 0.9, 0.1];
        let noise = [0.7, -1.2, 0.1, 1.9];
        let (temperature, by_action) = (0.4, [0.5, -2.0, 1.0, 3.0]);
        // The value of a row is linear in its actions.
        let loss = |output: &[f32], noise: &[f32]| {
            let drawn = DrawnActions::new(output, noise.to_vec(), 2, (-1.0, 3.0));
            let tangents = drawn.terms.iter().map(|term| 1.0 + 2.0 * term.tangent);
            let value: f64 = tangents.zip(by_action).map(|(a, by)| a * f64::from(by)).sum();
            0.5 * (temperature * drawn.log_prob.iter().sum::<f64>() - value)
        };
        let drawn = DrawnActions::new(&output, noise.to_vec(), 2, (-1.0, 3.0));
        let found = drawn.gradient(temperature, &by_action);
        for at in 0..output.len() {
            let moved = |by: f32| {
                let mut moved = output;
                moved[at] += by;
                (f64::from(moved[at]), loss(&moved, &noise))
            };
            let (above, below) = (moved(1e-3), moved(-1e-3));
            let slope = (above.1 - below.1) / (above.0 - below.0);
            assert!((f64::from(found[at]) - slope).abs() < 1e-5, "{at}: {} {slope}", found[at]);
        }
        for (at, found) in drawn.noise_gradient(temperature, &by_action).into_iter().enumerate() {
            let moved = |by: f32| {
                let mut moved = noise;
                moved[at] += by;
                (f64::from(moved[at]), loss(&output, &moved))
            };
            let (above, below) = (moved(1e-3), moved(-1e-3));
            let slope = (above.1 - below.1) / (above.0 - below.0);
            assert!((found - slope).abs() < 1e-5, "noise {at}: {found} {slope}");
        }
    }
}
