//! Learnt loadings of the noise that an agent shares with the others.
//!
//! The standard normal noise of an action before tanh is `n = r z + sqrt(1 - |r|^2) eps`, with a signal `z` that all agents' actions
//! in a state share. The distribution of each action number alone does not depend on `r`; the value of joint actions does. Entropies
//! are sums over action numbers, as of HAPPO's Gaussians, so they do not depend on `r` either.

use libm::sqrt;
use policy::SharedNoise;
use policy::parameters::Parameters;
use policy::randomness::standard_normal;
use rand::RngCore;

use crate::error::MarlError;
use crate::influence::exact::{exact_information, square};
use crate::optimisation::gradient::Gradients;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::state::{Visitor, visit_parameters};

/// The loadings `r`, `[act, K]`, of one agent in training.
pub(super) struct Loadings {
    noise: SharedNoise,
    /// `loading`, the parameters `u` of `r = share 0.95 / sqrt(K) tanh(u)`.
    parameters: Parameters,
    adam: Adam,
    /// Weight of the exact information in the objective (Eq. 5).
    lambda: f64,
}

impl Loadings {
    /// The initial loadings of `actions` action dimensions.
    pub(super) fn new(
        noise: SharedNoise,
        actions: usize,
        adam: AdamConfig,
        lambda: f64,
    ) -> Result<Self, MarlError> {
        let mut parameters = Parameters::new();
        parameters.add("loading", noise.initial(actions)?)?;
        Ok(Self { noise, adam: Adam::new(adam, &parameters), parameters, lambda })
    }

    /// `K`, numbers of the signal.
    pub(super) fn signal_size(&self) -> usize {
        self.noise.size
    }

    /// `lambda`, the weight of the information.
    pub(super) fn lambda(&self) -> f64 {
        self.lambda
    }

    /// The parameters `u`, `[act, K]`.
    pub(super) fn parameters(&self) -> Result<Vec<f32>, MarlError> {
        Ok(self.parameters.values()?.concat())
    }

    /// The loadings `r`, `[act, K]`.
    pub(super) fn values(&self) -> Result<Vec<f64>, MarlError> {
        let loadings = self.noise.learnt(&self.parameters()?);
        Ok(loadings.into_iter().map(f64::from).collect())
    }

    /// The noise `n` `[R, act]` for a signal `[R, K]`.
    pub(super) fn noise(
        &self,
        signal: &[f32],
        rng: &mut impl RngCore,
    ) -> Result<Vec<f32>, MarlError> {
        let (loadings, size) = (self.values()?, self.noise.size);
        let mut noise = Vec::with_capacity(signal.len() / size * loadings.len() / size);
        for z in signal.chunks_exact(size) {
            for r in loadings.chunks_exact(size) {
                let (shared, own) = (shared(r, z), sqrt(1.0 - square(r)));
                noise.push((shared + own * f64::from(standard_normal(rng))) as f32);
            }
        }
        Ok(noise)
    }

    /// One descent step on the policy's loss minus `lambda` times the information between the agent's actions and the others',
    /// whose loadings add the precision `others` `[K, K]` to the signal's. `by_noise` `[R, act]` is the gradient of the policy's loss by
    /// the noise `n` `[R, act]` that was drawn for `signal` `[R, K]`. Returns the information, nats.
    pub(super) fn step(
        &mut self,
        (noise, by_noise): (&[f32], &[f64]),
        signal: &[f32],
        others: &[f64],
    ) -> Result<f64, MarlError> {
        let (loadings, size) = (self.values()?, self.noise.size);
        let (information, slopes) = exact_information(&loadings, others, size);
        let by_loading = loading_gradient(&loadings, (noise, by_noise), signal, size);
        let by_u = self.noise.learnt_slopes(&self.parameters()?);
        let terms = by_loading.iter().zip(&slopes).zip(by_u);
        let gradient =
            terms.map(|((loss, slope), by_u)| ((loss - self.lambda * slope) * by_u) as f32);
        self.adam.step(&self.parameters, &Gradients(vec![gradient.collect()]))?;
        Ok(information)
    }

    /// From now on with this fraction of the loadings.
    pub(super) fn scale(&mut self, share: f32) {
        self.noise = self.noise.scaled(share);
    }

    pub(super) fn scale_learning_rate(&mut self, share: f64) {
        self.adam.scale_learning_rate(share);
    }

    pub(super) fn skipped(&self) -> i64 {
        self.adam.skipped()
    }

    /// Visits the arrays of `noise_I`.
    pub(super) fn visit(&mut self, name: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        visit_parameters(visitor, &format!("weights/{name}."), &self.parameters)?;
        self.adam.visit(&format!("optimizer/{name}."), visitor)
    }
}

/// Gradient by the loadings `[act, K]` of a loss whose gradient by the noise `n` `[R, act]` is given: `dn/dr = z - r eps / own` with the
/// agent's own `eps = (n - r z) / own` and `own = sqrt(1 - |r|^2)`.
fn loading_gradient(
    loadings: &[f64],
    (noise, by_noise): (&[f32], &[f64]),
    signal: &[f32],
    size: usize,
) -> Vec<f64> {
    let actions = loadings.len() / size;
    let mut gradient = vec![0.0; loadings.len()];
    let rows = noise.chunks_exact(actions).zip(by_noise.chunks_exact(actions));
    for ((noise, by_noise), z) in rows.zip(signal.chunks_exact(size)) {
        let dimensions = loadings.chunks_exact(size).zip(gradient.chunks_exact_mut(size));
        for ((r, to), (&n, &by_n)) in dimensions.zip(noise.iter().zip(by_noise)) {
            let own_noise = (f64::from(n) - shared(r, z)) / (1.0 - square(r));
            for ((to, r), &z) in to.iter_mut().zip(r).zip(z) {
                *to += by_n * (f64::from(z) - r * own_noise);
            }
        }
    }
    gradient
}

/// `r z`
fn shared(r: &[f64], z: &[f32]) -> f64 {
    r.iter().zip(z).map(|(r, &z)| r * f64::from(z)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_by_loadings_matches_finite_differences_of_the_noise() {
        // Two rows of two actions and a signal of two numbers; each agent's own noise stays the same.
        let (loadings, own) = ([0.3, -0.5, 0.6, 0.2], [0.7, -1.2, 0.1, 1.9]);
        let (signal, by_noise) = ([0.4_f32, -1.1, 0.9, 0.3], [0.5, -2.0, 1.0, 3.0]);
        let noise = |loadings: &[f64]| -> Vec<f64> {
            let pairs = signal.chunks_exact(2).zip(own.chunks_exact(2));
            let row = |(z, own): (&[f32], &[f64])| {
                let rows = loadings.chunks_exact(2).zip(own);
                rows.map(|(r, own)| shared(r, z) + sqrt(1.0 - square(r)) * own).collect::<Vec<_>>()
            };
            pairs.flat_map(row).collect()
        };
        let drawn: Vec<f32> = noise(&loadings).iter().map(|&n| n as f32).collect();
        let found = loading_gradient(&loadings, (&drawn, &by_noise), &signal, 2);
        for (at, found) in found.into_iter().enumerate() {
            let moved = |by: f64| {
                let mut to = loadings;
                to[at] += by;
                noise(&to).iter().zip(by_noise).map(|(n, by)| n * by).sum::<f64>()
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((found - slope).abs() < 1e-6, "{at}: {found} {slope}");
        }
    }
}
