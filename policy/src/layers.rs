//! A network's layers with the names and starts of their parameters.

use kernels::{Activation, Layer, Network};
use rand::RngCore;

use crate::initialise::orthogonal;

/// Gain of an orthogonal start before a hyperbolic tangent.
pub const TANH_GAIN: f64 = 5.0 / 3.0;
/// Gain of an orthogonal start before a rectifier, `sqrt(2)`.
pub const RELU_GAIN: f64 = core::f64::consts::SQRT_2;

/// One layer of a network that is declared.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerSpec {
    name: String,
    layer: Layer,
    /// Of the orthogonal starts of weights.
    gain: f64,
}

impl LayerSpec {
    /// A layer norm of `width` numbers: `NAME.weight`, `NAME.bias`.
    #[must_use]
    pub fn norm(name: &str, width: usize) -> Self {
        Self { name: name.to_owned(), layer: Layer::Norm { width }, gain: 1.0 }
    }

    /// A linear map of `inputs` to `outputs` numbers with an orthogonal start: `NAME.weight`, `NAME.bias`.
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
    pub fn gru(name: &str, (inputs, hidden): (usize, usize)) -> Self {
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

    /// Starts of all its parameters, one after another, drawn from `rng`.
    pub fn start(&self, rng: &mut impl RngCore) -> Vec<f32> {
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

/// The network that these layers make.
#[must_use]
pub fn network_of(specs: &[LayerSpec]) -> Network {
    Network::new(specs.iter().map(|spec| spec.layer).collect())
}
