//! Layers and their sizes.

use core::ops::Range;

/// Function applied to the result of a linear map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// `x`.
    Identity,
    /// Hyperbolic tangent.
    Tanh,
    /// `max(x, 0)`.
    Relu,
}

/// A layer. Its parameters have PyTorch's shapes and order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// `(x - mean) / sqrt(var + 1e-5) * weight + bias` over a row, with the biased variance; parameters `weight`,
    /// `bias`, `[width]` each.
    Norm {
        /// Width of an input row.
        width: usize,
    },
    /// `activation(x W^T + b)`; parameters `W` `[outputs, inputs]`, `b` `[outputs]`.
    Linear {
        /// Width of an input row.
        inputs: usize,
        /// Width of an output row.
        outputs: usize,
        /// Applied to every value of the result.
        activation: Activation,
    },
    /// A gated recurrent unit over `T` steps of `B` sequences, rows `t * B + b`:
    /// `h_t = (1 - z) n + z h'`, `h' = mask_t h_(t-1)`, `r, z = sigmoid(W_i x + b_i + W_h h' + b_h)`,
    /// `n = tanh(W_in x + b_in + r (W_hn h' + b_hn))`; parameters `W_i` `[3H, inputs]`, `b_i` `[3H]`, `W_h`
    /// `[3H, H]`, `b_h` `[3H]`, gates in the order r, z, n.
    Gru {
        /// Width of an input row.
        inputs: usize,
        /// Recurrent units, `H`.
        hidden: usize,
    },
}

impl Layer {
    /// Width of an input row.
    #[must_use]
    pub fn inputs(self) -> usize {
        match self {
            Self::Norm { width } => width,
            Self::Linear { inputs, .. } | Self::Gru { inputs, .. } => inputs,
        }
    }

    /// Width of an output row.
    #[must_use]
    pub fn outputs(self) -> usize {
        match self {
            Self::Norm { width } => width,
            Self::Linear { outputs, .. } => outputs,
            Self::Gru { hidden, .. } => hidden,
        }
    }

    /// Number of its parameters (scalars).
    #[must_use]
    pub fn parameters(self) -> usize {
        match self {
            Self::Norm { width } => 2 * width,
            Self::Linear { inputs, outputs, .. } => outputs * (inputs + 1),
            Self::Gru { inputs, hidden } => 3 * hidden * (inputs + hidden + 2),
        }
    }
}

/// A sequence of layers with at most one GRU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Network {
    layers: Vec<Layer>,
}

impl Network {
    /// A network of these layers.
    ///
    /// # Panics
    /// If there is no layer, a layer has no units, two widths do not match, or there are two GRUs.
    #[must_use]
    pub fn new(layers: Vec<Layer>) -> Self {
        assert!(!layers.is_empty(), "a network without layers");
        assert!(layers.iter().all(|layer| layer.inputs() > 0 && layer.outputs() > 0), "{layers:?}");
        assert!(layers.windows(2).all(|two| two[0].outputs() == two[1].inputs()), "{layers:?}");
        let recurrent = layers.iter().filter(|layer| matches!(layer, Layer::Gru { .. }));
        assert!(recurrent.count() <= 1, "two GRUs: {layers:?}");
        Self { layers }
    }

    /// The layers in order.
    #[must_use]
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Width of an input row.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs()
    }

    /// Width of an output row.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs()
    }

    /// Layer index and units of the GRU.
    #[must_use]
    pub fn gru(&self) -> Option<(usize, usize)> {
        let found = self.layers.iter().position(|layer| matches!(layer, Layer::Gru { .. }))?;
        Some((found, self.layers[found].outputs()))
    }

    /// Number of all parameters (scalars).
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.layers.iter().map(|layer| layer.parameters()).sum()
    }

    /// The range of each layer's parameters in the concatenation of all.
    pub(crate) fn ranges(&self) -> Vec<Range<usize>> {
        let mut end = 0;
        let range = |layer: &Layer| {
            let start = end;
            end += layer.parameters();
            start..end
        };
        self.layers.iter().map(range).collect()
    }
}
