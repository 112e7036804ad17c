//! The central action value of one agent: the value of a joint action in a global state.

use candle_core::Tensor;
use policy::ops::LayerStack;
use policy::parameters::Parameters;
use rand::RngCore;

use crate::config::CriticConfig;
use crate::error::MarlError;
use crate::optimisation::layers::{Normalisation, rectified_layers};

/// Layers of Linear, ReLU, then one value.
pub(super) struct ActionValue {
    pub(super) parameters: Parameters,
    layers: LayerStack,
}

impl ActionValue {
    /// An action value of `inputs` features of state and joint action.
    pub(super) fn new(
        config: &CriticConfig,
        inputs: usize,
        rng: &mut impl RngCore,
    ) -> Result<Self, MarlError> {
        let shape = (inputs, config.width, config.layers);
        let specs = rectified_layers(shape, Normalisation::None, 1);
        let mut parameters = Parameters::new();
        let layers = LayerStack::declare(&mut parameters, &specs, rng)?;
        Ok(Self { parameters, layers })
    }

    /// Values `[R, 1]` of joined states and actions, `[R, S + A]`.
    pub(super) fn forward(&self, input: &Tensor) -> Result<Tensor, MarlError> {
        Ok(self.layers.weights()?.apply(input, None)?)
    }

    /// As [`ActionValue::forward`], for gradients only with respect to the input.
    pub(super) fn forward_as_constant(&self, input: &Tensor) -> Result<Tensor, MarlError> {
        Ok(self.layers.constant_weights()?.apply(input, None)?)
    }
}
