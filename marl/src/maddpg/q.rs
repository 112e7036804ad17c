//! The central action value of one agent: what a joint action is worth in a global state.

use candle_core::Tensor;
use policy::Precision;
use policy::ops::Activation;
use policy::parameters::Parameters;
use rand::RngCore;

use crate::config::CriticConfig;
use crate::error::MarlError;
use crate::layers::{Builder, Dense, RELU_GAIN};

/// Layers of Linear, ReLU, then one value.
pub(super) struct ActionValue {
    pub(super) parameters: Parameters,
    layers: Vec<Dense>,
    value: Dense,
}

impl ActionValue {
    /// For `inputs` numbers of state and joint action.
    pub(super) fn new(
        config: &CriticConfig,
        inputs: usize,
        precision: Precision,
        rng: &mut impl RngCore,
    ) -> Result<Self, MarlError> {
        let mut builder = Builder { parameters: Parameters::new(), precision, rng };
        let (mut layers, mut from) = (Vec::with_capacity(config.layers), inputs);
        for layer in 0..config.layers {
            let (name, shape) = (format!("layers.{layer}.linear"), (from, config.width));
            layers.push(builder.dense(&name, shape, RELU_GAIN, Activation::Relu)?);
            from = config.width;
        }
        let value = builder.dense("value", (from, 1), 1.0, Activation::Identity)?;
        Ok(Self { parameters: builder.parameters, layers, value })
    }

    /// Values `[R, 1]` of states and joint actions side by side, `[R, S + A]`.
    pub(super) fn forward(&self, input: &Tensor) -> Result<Tensor, MarlError> {
        self.pass(input, Dense::apply)
    }

    /// As [`ActionValue::forward`], for gradients by the input alone.
    pub(super) fn forward_as_constant(&self, input: &Tensor) -> Result<Tensor, MarlError> {
        self.pass(input, Dense::apply_as_constant)
    }

    fn pass(
        &self,
        input: &Tensor,
        apply: impl Fn(&Dense, &Tensor) -> Result<Tensor, MarlError>,
    ) -> Result<Tensor, MarlError> {
        let mut x = input.clone();
        for layer in &self.layers {
            x = apply(layer, &x)?;
        }
        apply(&self.value, &x)
    }
}
