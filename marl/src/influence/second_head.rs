//! The paper's second head (Fig. 1): `q_xi(a^i | a^-i, o^i, h^i)` on the policy's trunk. Eq. (10) trains both heads and
//! the trunk with one optimiser.

use candle_core::{Device, Tensor, Var};
use policy::ops::{LayerStack, Weights, sigmoid};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{Distribution, Gaussian, PolicyConfig, project_sigma};

use crate::config::InfluenceConfig;
use crate::distribution::HeadRows;
use crate::error::MarlError;
use crate::influence::posterior::{Conditions, PosteriorShape, stacks};
use crate::optimisation::layers::rows;

/// A Gaussian over the agent's action. `a^-i` is encoded (Linear, tanh) and joined with the trunk's features; Linear,
/// tanh and Linear give the mean. Sigma is a separate parameter, as in the policy's head.
pub(crate) struct SecondHead {
    others: usize,
    sigma_scale: f64,
    sigma_floor: f64,
    parameters: Parameters,
    /// Input: the other agents' actions.
    encoder: LayerStack,
    /// Input: features and encoded actions.
    joined: LayerStack,
    log_std: Var,
}

impl SecondHead {
    /// A head of this shape for agent `agent`, with initial weights.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn new(
        config: &InfluenceConfig,
        policy: &PolicyConfig,
        shape: PosteriorShape,
        (seed, agent): (RunSeed, u32),
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::PosteriorInitialisation).agent(agent));
        let mut parameters = Parameters::new();
        let head = (shape.action, f64::from(policy.head_gain));
        let [encoder, joined] = stacks(config, shape, head, &mut parameters, &mut rng)?;
        let start = Tensor::full(policy.initial_log_std(), shape.action, &Device::Cpu)?;
        let log_std = parameters.add("log_std", start)?;
        Ok(Self {
            others: shape.others,
            sigma_scale: f64::from(policy.sigma_scale),
            sigma_floor: config.posterior_sigma_floor,
            parameters,
            encoder,
            joined,
            log_std,
        })
    }

    /// All parameters.
    pub(crate) fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The current weights, to be read once per optimiser step.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn weights(&self) -> Result<[Weights; 2], MarlError> {
        Ok([self.encoder.weights()?, self.joined.weights()?])
    }

    /// `q_xi` of every row; the trunk's features are `[R, F]`, the others' actions `[R, others]`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn distribution(
        &self,
        [encoder, joined]: &[Weights; 2],
        features: &Tensor,
        others: Vec<f32>,
    ) -> Result<Distribution, MarlError> {
        let encoded = encoder.apply(&rows(others, self.others)?, None)?;
        let mean = joined.apply(&Tensor::cat(&[features, &encoded], 1)?, None)?;
        let sigma = (sigmoid(self.log_std.as_tensor())? * self.sigma_scale)?;
        Ok(Distribution::Gaussian(Gaussian { mean, sigma, loading: None }))
    }

    /// `q_xi` of every row of `data`, as constants.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn conditional(&self, data: &Conditions<'_>) -> Result<HeadRows, MarlError> {
        let weights = [self.encoder.constant_weights()?, self.joined.constant_weights()?];
        HeadRows::of(&self.distribution(&weights, data.features, data.others.to_vec())?)
    }

    /// Clamps sigma to its floor, as in the policy's head.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn project(&self) -> Result<(), MarlError> {
        Ok(project_sigma(&self.log_std, self.sigma_floor, self.sigma_scale)?)
    }
}
