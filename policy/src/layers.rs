//! Layers with the names and initial values of their parameters.

use kernels::{Activation, Layer, Network};
use rand::RngCore;

use crate::initialise::orthogonal;

/// Gain of an orthogonal initialisation before tanh.
pub const TANH_GAIN: f64 = 5.0 / 3.0;
/// Gain of an orthogonal initialisation before ReLU, `sqrt(2)`.
pub const RELU_GAIN: f64 = core::f64::consts::SQRT_2;

/// Declaration of one layer.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerSpec {
    name: String,
    layer: Layer,
    /// Gain of the orthogonal initialisation.
    gain: f64,
}

impl LayerSpec {
    /// A layer norm of `width` features: `NAME.weight`, `NAME.bias`.
    #[must_use]
    pub fn norm(name: &str, width: usize) -> Self {
        Self { name: name.to_owned(), layer: Layer::Norm { width }, gain: 1.0 }
    }

    /// A linear map from `inputs` to `outputs` features with orthogonal initialisation: `NAME.weight`, `NAME.bias`.
    #[must_use]
    pub fn linear(
        name: &str,
        (inputs, outputs): (usize, usize),
        activation: Activation,
        gain: f64,
    ) -> Self {
        Self { name: name.to_owned(), layer: Layer::Linear { inputs, outputs, activation }, gain }
    }

    /// A GRU: `NAME.weight_ih`, `NAME.bias_ih`, `NAME.weight_hh`, `NAME.bias_hh`; every gate's block is orthogonal.
    #[must_use]
    pub fn gru(name: &str, inputs: usize, hidden: usize) -> Self {
        Self { name: name.to_owned(), layer: Layer::Gru { inputs, hidden }, gain: 1.0 }
    }

    /// Names and shapes of its parameters, in the order of [`Layer`].
    #[must_use]
    pub fn parameters(&self) -> Vec<(String, Vec<usize>)> {
        let name = |suffix: &str| format!("{}.{suffix}", self.name);
        match self.layer {
            Layer::Norm { width } => {
                vec![(name("weight"), vec![width]), (name("bias"), vec![width])]
            }
            Layer::Linear { inputs, outputs, .. } => {
                vec![(name("weight"), vec![outputs, inputs]), (name("bias"), vec![outputs])]
            }
            Layer::Gru { inputs, hidden } => vec![
                (name("weight_ih"), vec![3 * hidden, inputs]),
                (name("bias_ih"), vec![3 * hidden]),
                (name("weight_hh"), vec![3 * hidden, hidden]),
                (name("bias_hh"), vec![3 * hidden]),
            ],
        }
    }

    /// Concatenated initial values of all its parameters, drawn from `rng`.
    pub(crate) fn initial_values(&self, rng: &mut impl RngCore) -> Vec<f32> {
        match self.layer {
            Layer::Norm { width } => [vec![1.0; width], vec![0.0; width]].concat(),
            Layer::Linear { inputs, outputs, .. } => {
                let weight = orthogonal(rng, outputs, inputs, self.gain);
                [weight, vec![0.0; outputs]].concat()
            }
            Layer::Gru { inputs, hidden } => {
                let mut all = Vec::new();
                for width in [inputs, hidden] {
                    for _ in 0..3 {
                        all.extend(orthogonal(rng, hidden, width, self.gain));
                    }
                    all.resize(all.len() + 3 * hidden, 0.0);
                }
                all
            }
        }
    }
}

/// The network of these layers.
#[must_use]
pub fn network_of(specs: &[LayerSpec]) -> Network {
    Network::new(specs.iter().map(|spec| spec.layer).collect())
}
