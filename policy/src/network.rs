//! The actor network that the learner trains.

use candle_core::{DType, Device, Tensor, Var};
use rand::RngCore;

use crate::acting::{ActorPolicy, ActorSpec};
use crate::categorical::Categorical;
use crate::config::{CoreKind, PolicyConfig};
use crate::error::PolicyError;
use crate::gaussian::Gaussian;
use crate::head::{Distribution, Head};
use crate::initialise::orthogonal;
use crate::ops::{Activation, gru_sequence, layer_norm, linear, sigmoid};
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

/// One agent's actor: the trunk (everything up to the features) and the head of the policy `p`.
#[derive(Debug)]
pub struct ActorNetwork {
    spec: ActorSpec,
    sigma_floor: f64,
    parameters: Parameters,
    trunk: Trunk,
    head: Dense,
    /// Only where deviations are learnt.
    log_std: Option<Var>,
}

#[derive(Debug)]
enum Trunk {
    Gru { norm: Norm, encoder: Dense, input: Dense, recurrent: Dense, output: Norm },
    Mlp { norm: Norm, layers: Vec<(Dense, Norm)> },
}

#[derive(Debug)]
struct Dense {
    weight: Var,
    bias: Var,
}

#[derive(Debug)]
struct Norm {
    weight: Var,
    bias: Var,
}

impl Dense {
    fn apply(&self, x: &Tensor, activation: Activation) -> candle_core::Result<Tensor> {
        linear(x, self.weight.as_tensor(), self.bias.as_tensor(), activation)
    }
}

impl Norm {
    fn apply(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        layer_norm(x, self.weight.as_tensor(), self.bias.as_tensor())
    }
}

/// Gain of an orthogonal start before a hyperbolic tangent.
const TANH_GAIN: f64 = 5.0 / 3.0;
/// Gain of an orthogonal start before a rectifier, `sqrt(2)`.
const RELU_GAIN: f64 = core::f64::consts::SQRT_2;

/// Declares layers, drawing their starts in order.
struct Builder<'a, R> {
    parameters: Parameters,
    dtype: DType,
    rng: &'a mut R,
}

impl<R: RngCore> Builder<'_, R> {
    fn parameter(
        &mut self,
        name: &str,
        data: Vec<f32>,
        shape: &[usize],
    ) -> Result<Var, PolicyError> {
        let value = Tensor::from_vec(data, shape, &Device::Cpu)?.to_dtype(self.dtype)?;
        self.parameters.add(name, value)
    }

    fn norm(&mut self, name: &str, width: usize) -> Result<Norm, PolicyError> {
        let weight = self.parameter(&format!("{name}.weight"), vec![1.0; width], &[width])?;
        let bias = self.parameter(&format!("{name}.bias"), vec![0.0; width], &[width])?;
        Ok(Norm { weight, bias })
    }

    fn dense(
        &mut self,
        name: &str,
        from: usize,
        to: usize,
        gain: f64,
    ) -> Result<Dense, PolicyError> {
        let start = orthogonal(self.rng, to, from, gain);
        let weight = self.parameter(&format!("{name}.weight"), start, &[to, from])?;
        let bias = self.parameter(&format!("{name}.bias"), vec![0.0; to], &[to])?;
        Ok(Dense { weight, bias })
    }

    /// One of the GRU's two linear maps, `suffix` `ih` or `hh`: a block per gate, each orthogonal.
    fn gates(&mut self, suffix: &str, from: usize, hidden: usize) -> Result<Dense, PolicyError> {
        let start = (0..3).flat_map(|_| orthogonal(self.rng, hidden, from, 1.0)).collect();
        let weight = self.parameter(&format!("gru.weight_{suffix}"), start, &[3 * hidden, from])?;
        let bias =
            self.parameter(&format!("gru.bias_{suffix}"), vec![0.0; 3 * hidden], &[3 * hidden])?;
        Ok(Dense { weight, bias })
    }

    fn trunk(&mut self, config: &PolicyConfig, observation: usize) -> Result<Trunk, PolicyError> {
        let norm = self.norm("encoder.norm", observation)?;
        match config.core {
            CoreKind::Gru => Ok(Trunk::Gru {
                norm,
                encoder: self.dense("encoder.linear", observation, config.encoder, TANH_GAIN)?,
                input: self.gates("ih", config.encoder, config.hidden)?,
                recurrent: self.gates("hh", config.hidden, config.hidden)?,
                output: self.norm("output.norm", config.hidden)?,
            }),
            CoreKind::Mlp => {
                let mut layers = Vec::with_capacity(config.layers);
                let mut from = observation;
                for layer in 0..config.layers {
                    let name = format!("layers.{layer}");
                    let dense =
                        self.dense(&format!("{name}.linear"), from, config.width, RELU_GAIN)?;
                    layers.push((dense, self.norm(&format!("{name}.norm"), config.width)?));
                    from = config.width;
                }
                Ok(Trunk::Mlp { norm, layers })
            }
        }
    }
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
        let mut builder = Builder { parameters: Parameters::new(), dtype, rng };
        let trunk = builder.trunk(config, observation)?;
        let spec = ActorSpec::new(config, observation, (action, kind))?;
        let gain = f64::from(config.head_gain);
        let dense = builder.dense("head", spec.feature_size(), spec.outputs(), gain)?;
        let log_std = match kind {
            Head::Gaussian => {
                let start = vec![config.initial_log_std; action];
                Some(builder.parameter("head.log_std", start, &[action])?)
            }
            Head::Categorical { .. } | Head::Deterministic { .. } | Head::Uniform { .. } => None,
        };
        let sigma_floor = f64::from(config.sigma_floor);
        Ok(Self { spec, sigma_floor, parameters: builder.parameters, trunk, head: dense, log_std })
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

    /// What the heads see, `[T*B, F]`.
    ///
    /// # Errors
    /// If shapes or element types do not fit.
    pub fn features(&self, input: &SequenceInput) -> Result<Tensor, PolicyError> {
        match &self.trunk {
            Trunk::Gru { norm, encoder, input: projection, recurrent, output } => {
                let states = states(norm, encoder, (projection, recurrent), input)?;
                Ok(output.apply(&states)?)
            }
            Trunk::Mlp { norm, layers } => {
                let mut x = norm.apply(&input.observation)?;
                for (dense, norm) in layers {
                    x = norm.apply(&dense.apply(&x, Activation::Relu)?)?;
                }
                Ok(x)
            }
        }
    }

    /// The recurrent state after the last step, `[B, H]`, of which no gradient is known; the one before the first
    /// step of a core without memory.
    ///
    /// # Errors
    /// If shapes or element types do not fit.
    pub fn last_state(&self, input: &SequenceInput) -> Result<Tensor, PolicyError> {
        match &self.trunk {
            Trunk::Gru { norm, encoder, input: projection, recurrent, .. } => {
                let (steps, sequences) = input.mask.dims2()?;
                let states = states(norm, encoder, (projection, recurrent), input)?.detach();
                Ok(states.narrow(0, (steps - 1) * sequences, sequences)?)
            }
            Trunk::Mlp { .. } => Ok(input.hidden.clone()),
        }
    }

    /// The policy `p(a | o, h)` from the features `[R, F]`: logits; or the mean with `sigma = sigmoid(log_std) *
    /// sigma_scale` where it is learnt, and the squashed mean with the deviation of its exploration where not.
    ///
    /// # Errors
    /// If shapes or element types do not fit.
    pub fn head(&self, features: &Tensor) -> Result<Distribution, PolicyError> {
        let head = self.spec.head();
        let output = match head.scale() {
            None => self.head.apply(features, Activation::Identity)?,
            Some((half, middle)) => self
                .head
                .apply(features, Activation::Tanh)?
                .affine(f64::from(half), f64::from(middle))?,
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
    /// optimiser step. A hard floor inside [`ActorNetwork::head`] would have no gradient below it, so
    /// that a sigma once there could never grow again.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn project(&self) -> Result<(), PolicyError> {
        let Some(log_std) = &self.log_std else { return Ok(()) };
        let share = self.sigma_floor / self.spec.sigma_scale();
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

    /// A plain copy to act with, in single precision.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn policy(&self) -> Result<ActorPolicy, PolicyError> {
        let mut single = Parameters::new();
        for (name, var) in self.parameters.iter() {
            single.add(name, var.as_tensor().to_dtype(DType::F32)?)?;
        }
        ActorPolicy::new(self.spec.clone(), single.to_arrays("")?)
    }
}

/// Recurrent states after every step, `[T*B, H]`.
fn states(
    norm: &Norm,
    encoder: &Dense,
    (projection, recurrent): (&Dense, &Dense),
    input: &SequenceInput,
) -> candle_core::Result<Tensor> {
    let encoded = encoder.apply(&norm.apply(&input.observation)?, Activation::Tanh)?;
    let projected = projection.apply(&encoded, Activation::Identity)?;
    let (weight, bias) = (recurrent.weight.as_tensor(), recurrent.bias.as_tensor());
    gru_sequence(&projected, weight, bias, &input.hidden, &input.mask)
}
