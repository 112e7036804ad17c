//! The actor network that the learner trains.

use candle_core::{DType, Device, Tensor, Var};
use rand::RngCore;

use crate::acting::{ActorPolicy, ActorSpec};
use crate::arrays::Array;
use crate::categorical::Categorical;
use crate::config::PolicyConfig;
use crate::error::PolicyError;
use crate::gaussian::Gaussian;
use crate::head::{Distribution, Head};
use crate::ops::{LayerStack, RecurrentInput, Weights, sigmoid};
use crate::parameters::Parameters;

/// `T` steps of `B` sequences, rows `t * B + b`.
#[derive(Clone, Debug)]
pub struct SequenceInput {
    /// Observations, `[T*B, obs]`.
    pub observation: Tensor,
    /// Recurrent state before the first step, `[B, H]`; not read by a core without memory.
    pub hidden: Tensor,
    /// 0 where the recurrent state is reset before the step, else 1, `[T, B]`.
    pub mask: Tensor,
}

impl SequenceInput {
    fn recurrent(&self) -> Option<RecurrentInput<'_>> {
        Some(RecurrentInput { start: &self.hidden, mask: &self.mask })
    }
}

/// One agent's actor: the trunk (everything up to the features) and the head of the policy `p`.
#[derive(Debug)]
pub struct ActorNetwork {
    spec: ActorSpec,
    sigma_floor: f64,
    parameters: Parameters,
    layers: LayerStack,
    /// Only where deviations are learnt.
    log_std: Option<Var>,
}

impl ActorNetwork {
    /// A network for `observation` features and `action` dimensions with a Gaussian head, its weights drawn
    /// from `rng`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn new(
        config: &PolicyConfig,
        observation: usize,
        action: usize,
        dtype: DType,
        rng: &mut impl RngCore,
    ) -> Result<Self, PolicyError> {
        Self::with_head(config, observation, (action, Head::Gaussian), dtype, rng)
    }

    /// As [`ActorNetwork::new`], for actions of `action` numbers that `head` gives.
    ///
    /// # Errors
    /// If such actions cannot come from `head`; passes on a tensor error.
    pub fn with_head(
        config: &PolicyConfig,
        observation: usize,
        (action, kind): (usize, Head),
        dtype: DType,
        rng: &mut impl RngCore,
    ) -> Result<Self, PolicyError> {
        let spec = ActorSpec::new(config, observation, (action, kind))?;
        let mut parameters = Parameters::new();
        let declared = spec.layer_specs(f64::from(config.head_gain));
        let layers = LayerStack::declare(&mut parameters, &declared, dtype, rng)?;
        let log_std = match kind {
            Head::Gaussian => {
                let start = Tensor::full(config.initial_log_std(), action, &Device::Cpu)?;
                Some(parameters.add("head.log_std", start.to_dtype(dtype)?)?)
            }
            Head::Categorical { .. } | Head::Deterministic { .. } | Head::Uniform { .. } => None,
        };
        let sigma_floor = f64::from(config.sigma_floor);
        Ok(Self { spec, sigma_floor, parameters, layers, log_std })
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

    /// Width `H` of the recurrent state, 0 without one.
    #[must_use]
    pub fn hidden_size(&self) -> usize {
        self.spec.hidden_size()
    }

    /// The layers' weights as they are now; to be taken once per optimiser step.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn weights(&self) -> Result<Weights, PolicyError> {
        Ok(self.layers.weights()?)
    }

    /// As [`ActorNetwork::weights`], those of the trunk and those of the head.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn split_weights(&self) -> Result<[Weights; 2], PolicyError> {
        Ok(self.layers.split_weights()?)
    }

    /// As [`ActorNetwork::distribution`] from [`ActorNetwork::split_weights`], with the trunk's features `[T*B, F]`, by
    /// which gradients are known.
    ///
    /// # Errors
    /// If shapes or element types do not fit.
    pub fn distribution_on_trunk(
        &self,
        [trunk, head]: &[Weights; 2],
        input: &SequenceInput,
    ) -> Result<(Distribution, Tensor), PolicyError> {
        let features = trunk.apply(&input.observation, input.recurrent())?;
        Ok((self.head(head.apply(&features, None)?)?, features))
    }

    /// The policy `p(a | o, h)` of every row under `weights`, which are this network's.
    ///
    /// # Errors
    /// If shapes or element types do not fit.
    pub fn distribution(
        &self,
        weights: &Weights,
        input: &SequenceInput,
    ) -> Result<Distribution, PolicyError> {
        self.head(weights.apply(&input.observation, input.recurrent())?)
    }

    /// As [`ActorNetwork::distribution`], a constant but for sigma, with what the head sees, `[T*B, F]`.
    ///
    /// # Errors
    /// If shapes or element types do not fit.
    pub fn distribution_and_features(
        &self,
        weights: &Weights,
        input: &SequenceInput,
    ) -> Result<(Distribution, Tensor), PolicyError> {
        let (features, output) =
            weights.features_and_output(&input.observation, input.recurrent())?;
        Ok((self.head(output)?, features))
    }

    /// The recurrent state after the last step, `[B, H]`, of which no gradient is known; the one before the first
    /// step of a core without memory.
    ///
    /// # Errors
    /// If shapes or element types do not fit.
    pub fn last_state(
        &self,
        weights: &Weights,
        input: &SequenceInput,
    ) -> Result<Tensor, PolicyError> {
        let recurrent = RecurrentInput { start: &input.hidden, mask: &input.mask };
        let found = weights.last_states(&input.observation, recurrent)?;
        Ok(found.unwrap_or_else(|| input.hidden.clone()))
    }

    /// From the layers' output `[R, out]`: logits; or the mean with `sigma = sigmoid(log_std) * sigma_scale` where it
    /// is learnt, and the squashed mean with the deviation of its exploration where not.
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
                Tensor::full(f64::from(sigma), size, &Device::Cpu)?.to_dtype(output.dtype())?
            }
            (None, None) => {
                return Ok(Distribution::Categorical(Categorical { logits: output }));
            }
        };
        Ok(Distribution::Gaussian(Gaussian { mean: output, sigma }))
    }

    /// Brings the parameters back to where sigma is at least its floor; to be called after every
    /// optimiser step. A hard floor inside the network would have no gradient below it, so
    /// that a sigma once there could never grow again.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn project(&self) -> Result<(), PolicyError> {
        let Some(log_std) = &self.log_std else { return Ok(()) };
        hold_sigma(log_std, self.sigma_floor, self.spec.sigma_scale())
    }

    /// A plain copy to act with, in single precision.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn policy(&self) -> Result<ActorPolicy, PolicyError> {
        let mut arrays = self.parameters.to_arrays("")?;
        for array in arrays.values_mut() {
            if let Array::F64 { shape, data } = array {
                let data = data.iter().map(|&x| x as f32).collect();
                *array = Array::F32 { shape: shape.clone(), data };
            }
        }
        ActorPolicy::new(self.spec.clone(), arrays)
    }
}

/// Raises `log_std` to where `sigma = sigmoid(log_std) * scale` is at least `floor`, which is below `scale`.
///
/// # Errors
/// Passes on a tensor error.
pub fn hold_sigma(log_std: &Var, floor: f64, scale: f64) -> Result<(), PolicyError> {
    let share = floor / scale;
    let lowest = libm::log(share / (1.0 - share));
    let values = log_std.as_tensor().to_dtype(DType::F64)?.to_vec1::<f64>()?;
    if values.iter().any(|&value| value < lowest) {
        let held: Vec<f64> = values.into_iter().map(|value| value.max(lowest)).collect();
        let width = held.len();
        let held = Tensor::from_vec(held, width, &Device::Cpu)?;
        log_std.set(&held.to_dtype(log_std.dtype())?)?;
    }
    Ok(())
}
