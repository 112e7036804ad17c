//! Exploration noise of which a part is a signal that all agents share, so that their simultaneous actions are
//! correlated: `a = mu + sigma (r z + sqrt(1 - |r|^2) eps)`, element-wise in the `act` action dimensions.
//!
//! The signal `z`, `[K]`, is standard normal. Its key names no agent, so every process computes it and none sends it.
//! The loadings `r`, `[act, K]`, have rows of norm below 1 and may decrease during a run; `eps` is each agent's own. Given `z`, the policy is a
//! diagonal Gaussian with mean `mu + sigma r z` and deviations `sigma sqrt(1 - |r|^2)`. Without `z`, its deviations are
//! `sigma`. Of a tanh-Gaussian this is the distribution before tanh.

use std::fmt;

use candle_core::{Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::error::PolicyError;
use crate::ops::sigmoid;
use crate::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use crate::tanh_gaussian;

/// Name of the parameters `u` of learnt loadings.
pub(crate) const LOADING: &str = "head.loading";
/// Largest norm of a row of loadings.
pub(crate) const LARGEST_LOADING: f32 = 0.95;
/// Most numbers of a signal.
pub(crate) const MAX_SIGNAL: usize = 8;
/// Most steps for which a signal stays the same.
pub(crate) const MAX_HOLD: u32 = 10_000;
/// Initial value of the parameters `u` of learnt loadings. At 0 neither exploration nor information has a gradient.
const INITIAL: f32 = 0.1;

/// How agents share a part of their noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SharedNoise {
    /// `K`, numbers of the signal.
    pub size: usize,
    /// Steps for which the signal stays the same.
    pub hold: u32,
    /// Norm of every row of loadings; absent if they are learnt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loading: Option<f32>,
    /// Fraction of the loadings with which agents act; absent: 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share: Option<f32>,
}

/// `shared noise of size K with constant (or learnt) loadings`, for messages.
impl fmt::Display for SharedNoise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let loadings = if self.loading.is_some() { "constant" } else { "learnt" };
        write!(f, "shared noise of size {} with {loadings} loadings", self.size)
    }
}

impl SharedNoise {
    /// Whether all values are in their ranges.
    pub(crate) fn is_valid(self) -> bool {
        let holds = |loading: f32| loading > 0.0 && loading <= LARGEST_LOADING;
        (1..=MAX_SIGNAL).contains(&self.size)
            && (1..=MAX_HOLD).contains(&self.hold)
            && self.loading.is_none_or(holds)
            && (0.0..=1.0).contains(&self.share())
    }

    fn share(self) -> f32 {
        self.share.unwrap_or(1.0)
    }

    /// The same noise with this fraction of the loadings.
    #[must_use]
    pub fn scaled(self, share: f32) -> Self {
        Self { share: Some(share).filter(|share| *share != 1.0), ..self }
    }

    /// The signal `[K]` of the step whose action has the key `action`, whichever agent's it is.
    #[must_use]
    pub fn signal(self, seed: RunSeed, action: Draw) -> Vec<f32> {
        let mut rng = generator(seed, action.of_signal(self.hold));
        (0..self.size).map(|_| standard_normal(&mut rng)).collect()
    }

    /// A matrix `[act, K]` with `value` where row `d` meets column `d mod K`, else 0.
    fn pattern(self, action: usize, value: f32) -> Vec<f32> {
        let element = |(row, column): (usize, usize)| {
            if row % self.size == column { value } else { 0.0 }
        };
        let rows = (0..action).flat_map(|row| (0..self.size).map(move |column| (row, column)));
        rows.map(element).collect()
    }

    /// Initial parameters `u`, `[act, K]`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn initial(self, action: usize) -> Result<Tensor, PolicyError> {
        let values = self.pattern(action, INITIAL);
        Ok(Tensor::from_vec(values, (action, self.size), &Device::Cpu)?)
    }

    /// Largest magnitude of a learnt loading with a share of 1, so that no row exceeds [`LARGEST_LOADING`].
    fn limit(self) -> f32 {
        LARGEST_LOADING / (self.size as f32).sqrt()
    }

    /// The constant loadings `[act, K]`; zeros if they are learnt.
    fn constant(self, action: usize) -> Vec<f32> {
        self.pattern(action, self.share() * self.loading.unwrap_or_default())
    }

    /// The loadings `share limit tanh(u)`, `[act, K]`, of parameters `u`.
    #[must_use]
    pub fn learnt(self, u: &[f32]) -> Vec<f32> {
        u.iter().map(|u| self.share() * self.limit() * kernels::tanh(*u)).collect()
    }

    /// The derivative of every loading of [`Self::learnt`] by its parameter.
    #[must_use]
    pub fn learnt_slopes(self, u: &[f32]) -> Vec<f64> {
        let slope = |u: &f32| {
            let tangent = f64::from(kernels::tanh(*u));
            f64::from(self.share() * self.limit()) * (1.0 - tangent * tangent)
        };
        u.iter().map(slope).collect()
    }

    /// The loadings of [`Self::learnt`] as a differentiable tensor, or the constant ones.
    pub(crate) fn loadings(self, u: Option<&Tensor>, action: usize) -> Result<Tensor, PolicyError> {
        let limit = f64::from(self.limit());
        match u {
            // tanh(u) = 2 sigmoid(2 u) - 1
            Some(u) => {
                let whole = sigmoid(&(u * 2.0)?)?.affine(2.0 * limit, -limit)?;
                // A tensor, because candle computes no gradient through `affine` by 0.
                let share = Tensor::full(self.share(), whole.shape(), &Device::Cpu)?;
                Ok((whole * share)?)
            }
            None => Ok(Tensor::from_vec(self.constant(action), (action, self.size), &Device::Cpu)?),
        }
    }
}

/// A policy's deviations given the signal.
#[derive(Clone, Debug)]
pub(crate) struct GivenSignal {
    noise: SharedNoise,
    /// `r`, `[act, K]`.
    loadings: Vec<f32>,
    /// `sigma r`, `[act, K]`; `r` if `sigma` depends on the observation.
    shifts: Vec<f32>,
    /// `sigma sqrt(1 - |r|^2)`, `[act]`.
    pub(crate) deviations: Vec<f32>,
    /// `sqrt(1 - |r|^2)`, `[act]`.
    pub(crate) own: Vec<f64>,
}

impl GivenSignal {
    /// Deviations of a policy with `sigma` `[act]`, and the parameters `u` `[act, K]` if its loadings are learnt.
    pub(crate) fn new(noise: SharedNoise, sigma: &[f32], u: Option<&[f32]>) -> Self {
        let loadings = u.map_or_else(|| noise.constant(sigma.len()), |u| noise.learnt(u));
        let rows = || loadings.chunks_exact(noise.size).zip(sigma);
        let shifts = rows().flat_map(|(row, sigma)| row.iter().map(move |r| sigma * r)).collect();
        let squares = |row: &[f32]| row.iter().map(|r| r * r).sum::<f32>();
        let deviations = rows().map(|(row, sigma)| sigma * (1.0 - squares(row)).sqrt()).collect();
        let own = loadings.chunks_exact(noise.size).map(own_part).collect();
        Self { noise, loadings, shifts, deviations, own }
    }

    /// Adds `sigma r z` to the means `[act]` of the step whose action has the key `action`. A tanh-Gaussian's output also has
    /// its deviations, `ls`, `[act]`.
    pub(crate) fn shift(&self, seed: RunSeed, action: Draw, output: &mut [f32]) {
        let signal = self.noise.signal(seed, action);
        let (means, ls) = output.split_at_mut(self.deviations.len());
        let rows = self.shifts.chunks_exact(signal.len());
        for (index, (mean, row)) in means.iter_mut().zip(rows).enumerate() {
            let sigma = ls.get(index).map_or(1.0, |l| tanh_gaussian::sigma(*l) as f32);
            *mean += sigma * row.iter().zip(&signal).map(|(shift, z)| shift * z).sum::<f32>();
        }
    }

    /// Mean norm of the rows of loadings.
    pub(crate) fn mean_loading(&self) -> f64 {
        let rows = self.loadings.chunks_exact(self.noise.size);
        rows.map(|row| square(row).sqrt()).sum::<f64>() / self.deviations.len() as f64
    }
}

/// `|r|^2` of a row of loadings.
fn square(r: &[f32]) -> f64 {
    r.iter().map(|&r| f64::from(r) * f64::from(r)).sum()
}

/// `sqrt(1 - |r|^2)` of a row of loadings: the fraction of a deviation that is the agent's own.
fn own_part(r: &[f32]) -> f64 {
    (1.0 - square(r)).sqrt()
}

impl Draw {
    /// The key of the signal that the agents share in the step of this key of an action. It is the same for `hold` steps.
    fn of_signal(self, hold: u32) -> Self {
        let purpose = match self.purpose {
            Purpose::ServedAction => Purpose::ServedSignal,
            _ => Purpose::Signal,
        };
        Self { purpose, agent: 0, step: self.step - self.step % hold, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ActorPolicy, CoreKind, Head, PolicyConfig, Scratch, probe};

    const SEED: RunSeed = RunSeed(4);

    fn noise(size: usize, hold: u32, loading: Option<f32>) -> SharedNoise {
        SharedNoise { size, hold, loading, share: None }
    }

    #[test]
    fn all_agents_share_a_signal_which_stays_for_the_steps_of_its_hold() {
        let of = |hold, step, agent| {
            noise(2, hold, None).signal(SEED, Draw::of_action(3, 1, step, agent))
        };
        assert_eq!(of(1, 7, 0), of(1, 7, 5));
        assert_ne!(of(1, 7, 0), of(1, 8, 0));
        assert_eq!((of(5, 5, 0), of(5, 9, 1)), (of(5, 7, 0), of(5, 7, 0)));
        assert_ne!(of(5, 9, 0), of(5, 10, 0));
        let key = Draw::of_action(3, 1, 7, 0);
        let served = Draw::of_served_action((3, 1), 7, 0);
        for other in [key.environment(2), key.iteration(4), served] {
            assert_ne!(noise(2, 1, None).signal(SEED, other), of(1, 7, 0));
        }
    }

    #[test]
    fn given_the_signal_means_shift_by_sigma_r_z_and_the_rest_of_the_variance_stays() {
        // tanh(0.549306) = 1/2, so r = 0.475; sigma sqrt(1 - 0.475^2) = 0.4 x 0.87999
        let given = GivenSignal::new(noise(1, 1, None), &[0.4, 0.2], Some(&[0.549_306, 0.0]));
        assert!((given.deviations[0] - 0.351_994).abs() < 1e-5, "{:?}", given.deviations);
        assert_eq!(given.deviations[1], 0.2);
        let key = Draw::of_action(0, 0, 0, 0);
        let z = noise(1, 1, None).signal(SEED, key)[0];
        let mut means = [1.0, 2.0];
        given.shift(SEED, key, &mut means);
        assert!((means[0] - (1.0 + 0.4 * 0.475 * z)).abs() < 1e-6 && means[1] == 2.0, "{means:?}");
        assert!((given.mean_loading() - 0.237_5).abs() < 1e-6);
    }

    #[test]
    fn a_constant_loading_is_the_norm_of_every_row_and_signals_take_turns() {
        let given = GivenSignal::new(noise(2, 1, Some(0.6)), &[0.5; 3], None);
        assert_eq!(given.loadings, [0.6, 0.0, 0.0, 0.6, 0.6, 0.0]);
        assert!(given.deviations.iter().all(|deviation| (deviation - 0.4).abs() < 1e-6));
        assert!((given.mean_loading() - 0.6).abs() < 1e-6);
    }

    #[test]
    fn a_share_scales_learnt_and_constant_loadings_and_without_one_noise_is_independent() {
        let u = [0.549_306, -0.2];
        for (loading, u) in [(Some(0.6), None), (None, Some(&u[..]))] {
            let of =
                |share: f32| GivenSignal::new(noise(1, 1, loading).scaled(share), &[0.4; 2], u);
            for (half, whole) in of(0.5).loadings.iter().zip(&of(1.0).loadings) {
                assert_eq!(*half, 0.5 * whole);
            }
            let mut means = [1.0, -2.0];
            of(0.0).shift(SEED, Draw::of_action(0, 0, 0, 0), &mut means);
            assert_eq!((means, of(0.0).deviations), ([1.0, -2.0], vec![0.4; 2]));
        }
        assert_eq!(noise(1, 1, None).scaled(1.0), noise(1, 1, None));
    }

    /// A policy with one tanh-Gaussian action, whose outputs are 0.3 and 0: the mean, and `l` of the deviation exp(-1.5).
    fn squashed(noise: Option<SharedNoise>) -> ActorPolicy {
        let config = PolicyConfig { width: 1, ..probe::config(CoreKind::Mlp) };
        let head = Head::TanhGaussian { low: -1.0, high: 1.0, noise };
        let parameters = [0.0, 0.0, 0.0, 0.0, 0.3, 0.0];
        let u = noise.filter(|noise| noise.loading.is_none()).map(|_| &[0.9][..]);
        ActorPolicy::without_norms(&config, (1, 1), head, (&parameters, u)).unwrap()
    }

    /// An output given the signal, and the action drawn.
    fn drawn(policy: &ActorPolicy, key: Draw) -> ([f32; 2], [f32; 1]) {
        let (mut output, mut action) = ([0.0; 2], [0.0]);
        policy.forward(1, &[1.0], &mut [], &mut output, &mut Scratch::default());
        policy.add_shared_noise(SEED, key, &mut output);
        policy.draw(&output, &mut generator(SEED, key), &mut action);
        (output, action)
    }

    #[test]
    fn before_tanh_noise_has_the_correlation_of_the_loadings_and_each_agent_its_own_moments() {
        let policy = squashed(Some(noise(1, 1, Some(0.7))));
        let count = 20_000;
        let (mut means, mut squares, mut product) = ([0.0; 2], [0.0; 2], 0.0);
        for environment in 0..count {
            let normal = [0, 1].map(|agent| {
                let action = drawn(&policy, Draw::of_action(0, environment, 0, agent)).1[0];
                (libm::atanh(f64::from(action)) - 0.3) / libm::exp(-1.5) / f64::from(count).sqrt()
            });
            for (agent, x) in normal.into_iter().enumerate() {
                means[agent] += x / f64::from(count).sqrt();
                squares[agent] += x * x;
            }
            product += normal[0] * normal[1];
        }
        assert!(means.iter().all(|mean| mean.abs() < 0.03), "{means:?}");
        assert!(squares.iter().all(|square| (square - 1.0).abs() < 0.04), "{squares:?}");
        assert!((product - 0.49).abs() < 0.03, "{product}");
    }

    #[test]
    fn a_tanh_gaussian_given_the_signal_matches_a_worked_case_and_without_loadings_is_independent()
    {
        let (shared, key) = (noise(1, 1, Some(0.7)), Draw::of_action(0, 3, 0, 1));
        let policy = squashed(Some(shared));
        let (output, _) = drawn(&policy, key);
        let mean = 0.3 + 0.223_130_16 * 0.7 * shared.signal(SEED, key)[0];
        assert!((output[0] - mean).abs() < 1e-6 && output[1] == 0.0, "{output:?} {mean}");
        // At the mean: -log(exp(-1.5) sqrt(1 - 0.49)) - log(2 pi) / 2 - log(1 - tanh(u)^2)
        let action = libm::tanh(f64::from(mean));
        let slope = libm::log(1.0 - action * action);
        let expected = 1.5 + 0.336_672_3 - 0.918_938_5 - slope;
        let found = f64::from(policy.log_prob(&output, &[action as f32]));
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        let decayed = squashed(Some(shared.scaled(0.0)));
        assert_eq!(drawn(&decayed, key), drawn(&squashed(None), key));
        assert_ne!(drawn(&policy, key), drawn(&decayed, key));
        assert_eq!(policy.uniform().head(), Head::Uniform { low: -1.0, high: 1.0 });
    }

    #[test]
    fn tensors_of_loadings_are_those_of_an_actor_and_no_row_exceeds_the_limit() {
        for (size, u) in [(1, vec![0.3, -9.0]), (2, vec![0.3, -0.1, 9.0, 9.0])] {
            let noise = noise(size, 1, None).scaled(0.75);
            let own = Tensor::from_vec(u.clone(), (2, size), &Device::Cpu).unwrap();
            let trained = noise.loadings(Some(&own), 2).unwrap().flatten_all().unwrap();
            let acting = GivenSignal::new(noise, &[0.5; 2], Some(&u)).loadings;
            let trained = trained.to_vec1::<f32>().unwrap();
            assert!(trained.iter().zip(&acting).all(|(a, b)| (a - b).abs() < 1e-6), "{trained:?}");
            let squares = |row: &[f32]| row.iter().map(|r| r * r).sum::<f32>();
            assert!(acting.chunks_exact(size).all(|row| squares(row).sqrt() < 0.75 * 0.950_001));
        }
    }
}
