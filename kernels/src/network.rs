//! What a network is made of.

use core::ops::Range;

/// What follows a linear map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// Hyperbolic tangent.
    Tanh,
    /// `max(x, 0)`.
    Relu,
}

/// A layer, its parameters in PyTorch's shapes and order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// `(x - mean) / sqrt(var + 1e-5) * weight + bias` over a row, with the biased variance; parameters `weight`,
    /// `bias`, `[width]` each.
    Norm {
        /// Numbers in a row.
        width: usize,
    },
    /// `activation(x W^T + b)`; parameters `W` `[outputs, inputs]`, `b` `[outputs]`.
    Linear {
        /// Numbers in a row.
        inputs: usize,
        /// Numbers in a row of the result.
        outputs: usize,
        /// What follows.
        activation: Activation,
    },
    /// A gated recurrent unit over `T` steps of `B` sequences, rows `t * B + b`:
    /// `h_t = (1 - z) n + z h'`, `h' = mask_t h_(t-1)`, `r, z = sigmoid(W_i x + b_i + W_h h' + b_h)`,
    /// `n = tanh(W_in x + b_in + r (W_hn h' + b_hn))`; parameters `W_i` `[3H, inputs]`, `b_i` `[3H]`, `W_h`
    /// `[3H, H]`, `b_h` `[3H]`, gates in the order r, z, n.
    Gru {
        /// Numbers in a row.
        inputs: usize,
        /// Recurrent units, `H`.
        hidden: usize,
    },
}

impl Layer {
    /// Numbers in a row of what it is given.
    #[must_use]
    pub fn inputs(self) -> usize {
        match self {
            Self::Norm { width } => width,
            Self::Linear { inputs, .. } | Self::Gru { inputs, .. } => inputs,
        }
    }

    /// Numbers in a row of its result.
    #[must_use]
    pub fn outputs(self) -> usize {
        match self {
            Self::Norm { width } => width,
            Self::Linear { outputs, .. } => outputs,
            Self::Gru { hidden, .. } => hidden,
        }
    }

    /// Numbers in its parameters.
    #[must_use]
    pub fn parameters(self) -> usize {
        match self {
            Self::Norm { width } => 2 * width,
            Self::Linear { inputs, outputs, .. } => outputs * (inputs + 1),
            Self::Gru { inputs, hidden } => 3 * hidden * (inputs + hidden + 2),
        }
    }
}

/// Layers one after another, with at most one GRU among them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Network {
    layers: Vec<Layer>,
}

impl Network {
    /// A network of these layers.
    ///
    /// # Panics
    /// If there is none, if one has no units, if two do not fit together, or if there are two GRUs.
    #[must_use]
    pub fn new(layers: Vec<Layer>) -> Self {
        assert!(!layers.is_empty(), "a network without layers");
        assert!(layers.iter().all(|layer| layer.inputs() > 0 && layer.outputs() > 0), "{layers:?}");
        assert!(layers.windows(2).all(|two| two[0].outputs() == two[1].inputs()), "{layers:?}");
        let recurrent = layers.iter().filter(|layer| matches!(layer, Layer::Gru { .. }));
        assert!(recurrent.count() <= 1, "two GRUs: {layers:?}");
        Self { layers }
    }

    /// The layers in their order.
    #[must_use]
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Numbers in a row of its input.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs()
    }

    /// Numbers in a row of its output.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs()
    }

    /// Index and units of the GRU.
    #[must_use]
    pub fn gru(&self) -> Option<(usize, usize)> {
        let found = self.layers.iter().position(|layer| matches!(layer, Layer::Gru { .. }))?;
        Some((found, self.layers[found].outputs()))
    }

    /// Numbers in all parameters.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.layers.iter().map(|layer| layer.parameters()).sum()
    }

    /// Where each layer's parameters stand among all.
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
