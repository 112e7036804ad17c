//! A linear map with its activation, for a block of rows.

use crate::buffer::{groups, numbers, padded, stride, unpadded};
use crate::math::tanh_of;
use crate::network::Activation;
use crate::product::{InitialSum, Left, Product, Right};
use crate::simd::{LANES, Line, Simd};

/// Weights in the order in which the kernel reads them.
#[derive(Clone, Debug)]
pub(crate) struct LinearWeights {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// `[groups of outputs][inputs]`, for `x W^T`.
    forward: Vec<Line>,
    /// `[groups of inputs][outputs]`, for `g W`.
    backward: Vec<Line>,
}

impl LinearWeights {
    /// From `[outputs, inputs]`.
    pub(crate) fn new(weight: &[f32], inputs: usize, outputs: usize) -> Self {
        assert_eq!(weight.len(), inputs * outputs, "weights of {inputs} to {outputs}");
        let mut forward = vec![Line::default(); groups(outputs) * inputs];
        let mut backward = vec![Line::default(); groups(inputs) * outputs];
        for (output, row) in weight.chunks_exact(inputs).enumerate() {
            let lines = &mut forward[output / LANES * inputs..][..inputs];
            for (line, &weight) in lines.iter_mut().zip(row) {
                line.0[output % LANES] = weight;
            }
            for (group, part) in row.chunks(LANES).enumerate() {
                backward[group * outputs + output].0[..part.len()].copy_from_slice(part);
            }
        }
        Self { inputs, outputs, forward, backward }
    }

    /// `y = start + x W^T` for `rows` rows.
    #[inline(always)]
    pub(crate) fn forward<'a>(
        &'a self,
        x: &'a [Line],
        y: &'a mut [Line],
        rows: usize,
        start: InitialSum<'a>,
    ) -> Product<'a> {
        let left = Left::rows(numbers(x), stride(self.inputs) * LANES, rows, self.inputs);
        let right = Right::packed(&self.forward, self.inputs);
        Product::lines(left, right, y, self.outputs, start)
    }

    /// `dx = start + g W` for `rows` rows.
    #[inline(always)]
    pub(crate) fn backward<'a>(
        &'a self,
        g: &'a [Line],
        dx: &'a mut [Line],
        rows: usize,
        start: InitialSum<'a>,
    ) -> Product<'a> {
        let left = Left::rows(numbers(g), stride(self.outputs) * LANES, rows, self.outputs);
        let right = Right::packed(&self.backward, self.outputs);
        Product::lines(left, right, dx, self.inputs, start)
    }

    /// Adds `g^T x` of `rows` rows to the gradient `[outputs, inputs]`.
    #[inline(always)]
    pub(crate) fn gradient<'a>(
        &self,
        g: &'a [Line],
        x: &'a [Line],
        rows: usize,
        gradient: &'a mut [f32],
    ) -> Product<'a> {
        let left = Left::columns(numbers(g), stride(self.outputs) * LANES, rows, self.outputs);
        let right = Right::rows(x, stride(self.inputs));
        Product::dense(left, right, gradient, self.inputs, InitialSum::Result)
    }
}

/// Adds the rows to `sums`, in row order.
#[inline(always)]
pub(crate) fn add_rows<S: Simd>(simd: S, rows: &[Line], sums: &mut [f32]) {
    let stride = stride(sums.len());
    let mut lines = padded(sums);
    for row in rows.chunks_exact(stride) {
        for (sum, line) in lines.iter_mut().zip(row) {
            simd.store(simd.add(simd.load(sum), simd.load(line)), sum);
        }
    }
    unpadded(&lines, sums);
}

/// A linear map with bias and activation.
#[derive(Clone, Debug)]
pub(crate) struct Linear {
    weights: LinearWeights,
    bias: Vec<Line>,
    activation: Activation,
}

impl Linear {
    /// From the concatenation of `W` `[outputs, inputs]` and `b` `[outputs]`.
    pub(crate) fn new(
        parameters: &[f32],
        inputs: usize,
        outputs: usize,
        activation: Activation,
    ) -> Self {
        let (weight, bias) = parameters.split_at(inputs * outputs);
        let weights = LinearWeights::new(weight, inputs, outputs);
        Self { weights, bias: padded(bias), activation }
    }

    #[inline(always)]
    pub(crate) fn forward<S: Simd>(&self, simd: S, x: &[Line], y: &mut [Line], rows: usize) {
        let product = self.weights.forward(x, y, rows, InitialSum::Bias(&self.bias));
        match self.activation {
            Activation::Identity => simd.outlined(&product),
            Activation::Relu => simd.outlined(&product.rectified()),
            Activation::Tanh => {
                simd.outlined(&product);
                for line in y {
                    simd.store(tanh_of(simd, simd.load(line)), line);
                }
            }
        }
    }

    /// Replaces the gradient `g` of the result `y` by the gradient before the activation, adds to the gradient of the
    /// parameters, and writes the gradient of `x`.
    #[inline(always)]
    pub(crate) fn backward<S: Simd>(
        &self,
        simd: S,
        x: &[Line],
        y: &[Line],
        g: &mut [Line],
        parameters: Option<&mut [f32]>,
        dx: Option<&mut [Line]>,
    ) {
        let rows = y.len() / stride(self.weights.outputs);
        self.before_activation(simd, y, g);
        if let Some(parameters) = parameters {
            let weights = self.weights.inputs * self.weights.outputs;
            let (weight, bias) = parameters.split_at_mut(weights);
            simd.outlined(&self.weights.gradient(g, x, rows, weight));
            add_rows(simd, g, bias);
        }
        if let Some(dx) = dx {
            simd.outlined(&self.weights.backward(g, dx, rows, InitialSum::Zero));
        }
    }

    #[inline(always)]
    fn before_activation<S: Simd>(&self, simd: S, y: &[Line], g: &mut [Line]) {
        let pairs = y.iter().zip(g);
        match self.activation {
            Activation::Identity => {}
            Activation::Relu => {
                for (y, g) in pairs {
                    simd.store(simd.where_positive(simd.load(y), simd.load(g)), g);
                }
            }
            Activation::Tanh => {
                for (y, g) in pairs {
                    let slope = slope_of_tanh(simd, simd.load(y));
                    simd.store(simd.mul(simd.load(g), slope), g);
                }
            }
        }
    }
}

/// `1 - y^2`.
#[inline(always)]
pub(crate) fn slope_of_tanh<S: Simd>(simd: S, y: S::Vector) -> S::Vector {
    simd.sub(simd.splat(1.0), simd.mul(y, y))
}
