//! The actor network that the learner trains.

use candle_core::{Device, Tensor, Var};
use rand::RngCore;

use crate::acting::{ActorPolicy, ActorSpec, LOG_STD, raise_log_std};
use crate::categorical::Categorical;
use crate::config::PolicyConfig;
use crate::error::PolicyError;
use crate::gaussian::Gaussian;
use crate::head::{Distribution, Head};
use crate::ops::{LayerStack, RecurrentInput, Weights, sigmoid};
use crate::parameters::Parameters;
use crate::shared_noise::LOADING;

/// `T` steps of `B` sequences, rows `t * B + b`.
#[derive(Clone, Debug)]
pub struct SequenceInput {
    /// Observations, `[T*B, obs]`.
    pub observation: Tensor,
    /// Recurrent state before the first step, `[B, H]`; ignored without a GRU.
    pub hidden: Tensor,
    /// 0 where the recurrent state is reset before the step, else 1, `[T, B]`.
    pub mask: Tensor,
}

impl SequenceInput {
    fn recurrent(&self) -> Option<RecurrentInput<'_>> {
        Some(RecurrentInput { start: &self.hidden, mask: &self.mask })
    }
}

/// One agent's actor network: the trunk (all layers but the last) and the head of the policy `p`.
#[derive(Clone, Debug)]
pub struct ActorNetwork {
    spec: ActorSpec,
    sigma_floor: f64,
    parameters: Parameters,
    layers: LayerStack,
    /// Only if sigma is learnt.
    log_std: Option<Var>,
    /// The parameters `u` of loadings, `[act, K]`; only if loadings are learnt.
    loading: Option<Var>,
}

impl ActorNetwork {
    /// A network for `observation` features and `action` action values. Its weights are drawn from `rng`.
    ///
    /// # Errors
    /// If `head` is invalid for `action` values or tanh-Gaussian; passes on a tensor error.
    pub fn new(
        config: &PolicyConfig,
        observation: usize,
        action: usize,
        head: Head,
        rng: &mut impl RngCore,
    ) -> Result<Self, PolicyError> {
        let spec = ActorSpec::new(config, observation, action, head)?;
        let mut parameters = Parameters::new();
        let declared = spec.layer_specs(f64::from(config.head_gain));
        let layers = LayerStack::declare(&mut parameters, &declared, rng)?;
        let log_std = match head {
            Head::Gaussian | Head::SharedGaussian(_) => {
                let start = Tensor::full(config.initial_log_std(), action, &Device::Cpu)?;
                Some(parameters.add(LOG_STD, start)?)
            }
            Head::Categorical { .. } | Head::Deterministic { .. } | Head::Uniform { .. } => None,
            Head::TanhGaussian { .. } => {
                let detail = format!("{head:?} is no distribution of an actor network");
                return Err(PolicyError::Snapshot(detail));
            }
        };
        let learnt = head.shared_noise().filter(|noise| noise.loading.is_none());
        let loading = match learnt {
            Some(noise) => Some(parameters.add(LOADING, noise.initial(action)?)?),
            None => None,
        };
        let sigma_floor = f64::from(config.sigma_floor);
        Ok(Self { spec, sigma_floor, parameters, layers, log_std, loading })
    }

    /// A network of the same parameters whose agents act with this fraction of the loadings of shared noise.
    #[must_use]
    pub fn with_noise_share(&self, share: f32) -> Self {
        Self { spec: self.spec.clone().with_noise_share(share), ..self.clone() }
    }

    /// All parameters, named as in PyTorch.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Width `F` of the features.
    #[must_use]
    pub fn feature_size(&self) -> usize {
        self.spec.feature_size()
    }

    /// Width `H` of the recurrent state, 0 without a GRU.
    #[must_use]
    pub fn hidden_size(&self) -> usize {
        self.spec.hidden_size()
    }

    /// The current weights of all layers. Call once per optimiser step.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn weights(&self) -> Result<Weights, PolicyError> {
        Ok(self.layers.weights()?)
    }

    /// As [`ActorNetwork::weights`], separately for trunk and head.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn split_weights(&self) -> Result<[Weights; 2], PolicyError> {
        Ok(self.layers.split_weights()?)
    }

    /// As [`ActorNetwork::distribution`] with [`ActorNetwork::split_weights`], and the differentiable features
    /// `[T*B, F]` of the trunk.
    ///
    /// # Errors
    /// If shapes or element types do not match.
    pub fn distribution_on_trunk(
        &self,
        [trunk, head]: &[Weights; 2],
        input: &SequenceInput,
    ) -> Result<(Distribution, Tensor), PolicyError> {
        let features = trunk.apply(&input.observation, input.recurrent())?;
        Ok((self.head(head.apply(&features, None)?)?, features))
    }

    /// The policy `p(a | o, h)` of every row, with `weights` of this network.
    ///
    /// # Errors
    /// If shapes or element types do not match.
    pub fn distribution(
        &self,
        weights: &Weights,
        input: &SequenceInput,
    ) -> Result<Distribution, PolicyError> {
        self.head(weights.apply(&input.observation, input.recurrent())?)
    }

    /// As [`ActorNetwork::distribution`], with the features `[T*B, F]`. Features and means (or logits) are constants.
    ///
    /// # Errors
    /// If shapes or element types do not match.
    pub fn distribution_and_features(
        &self,
        weights: &Weights,
        input: &SequenceInput,
    ) -> Result<(Distribution, Tensor), PolicyError> {
        let (features, output) =
            weights.features_and_output(&input.observation, input.recurrent())?;
        Ok((self.head(output)?, features))
    }

    /// From the layers' output `[R, out]`: logits; or the mean, with `sigma = sigmoid(log_std) * sigma_scale` if it
    /// is learnt, otherwise the fixed sigma of the head, and the loadings of shared noise.
    fn head(&self, output: Tensor) -> Result<Distribution, PolicyError> {
        let head = self.spec.head();
        let output = match head.scale() {
            None => output,
            Some((half, middle)) => output.affine(f64::from(half), f64::from(middle))?,
        };
        let sigma = match (&self.log_std, head.fixed_sigma()) {
            (Some(log_std), _) => (sigmoid(log_std.as_tensor())? * self.spec.sigma_scale())?,
            (None, Some(sigma)) => {
                let size = output.dim(1)?;
                Tensor::full(sigma, size, &Device::Cpu)?
            }
            (None, None) => {
                return Ok(Distribution::Categorical(Categorical { logits: output }));
            }
        };
        let u = self.loading.as_ref().map(Var::as_tensor);
        let loading = head.shared_noise().map(|noise| noise.loadings(u, self.spec.action));
        Ok(Distribution::Gaussian(Gaussian { mean: output, sigma, loading: loading.transpose()? }))
    }

    /// Projects the parameters to sigma at or above its floor. Call after every optimiser step. A hard floor inside the
    /// network has no gradient below it, so a smaller sigma could never grow again.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn project(&self) -> Result<(), PolicyError> {
        let Some(log_std) = &self.log_std else { return Ok(()) };
        project_sigma(log_std, self.sigma_floor, self.spec.sigma_scale())
    }

    /// A copy for acting, without a graph.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn policy(&self) -> Result<ActorPolicy, PolicyError> {
        ActorPolicy::new(self.spec.clone(), self.parameters.to_arrays()?)
    }
}

/// Raises `log_std` so that `sigma = sigmoid(log_std) * scale` is at least `floor`, which must be below `scale`.
///
/// # Errors
/// Passes on a tensor error.
pub fn project_sigma(log_std: &Var, floor: f64, scale: f64) -> Result<(), PolicyError> {
    let mut values = log_std.as_tensor().to_vec1::<f32>()?;
    raise_log_std(&mut values, floor, scale);
    Ok(log_std.set(&Tensor::from_iter(values, &Device::Cpu)?)?)
}
