//! Layers of the networks that only the learner uses: critics, posteriors and autoencoders.

use candle_core::{Device, Tensor};
use policy::layers::{LayerSpec, RELU_GAIN};
use policy::ops::Activation;

use crate::error::MarlError;

/// Normalisation after a rectified layer.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Normalisation {
    None,
    LayerNorm,
}

/// `layers` layers of Linear, ReLU and `normalisation` with `width` units each, then a linear layer with `outputs`
/// units.
pub(crate) fn rectified_layers(
    (inputs, width, layers): (usize, usize, usize),
    normalisation: Normalisation,
    outputs: usize,
) -> Vec<LayerSpec> {
    let mut specs = Vec::new();
    let mut from = inputs;
    for layer in 0..layers {
        let name = format!("layers.{layer}");
        let linear = format!("{name}.linear");
        let relu = Activation::Relu;
        specs.push(LayerSpec::linear(&linear, (from, width), relu, RELU_GAIN));
        if normalisation == Normalisation::LayerNorm {
            specs.push(LayerSpec::norm(&format!("{name}.norm"), width));
        }
        from = width;
    }
    specs.push(LayerSpec::linear("value", (from, outputs), Activation::Identity, 1.0));
    specs
}

/// `[R, width]` values as a constant tensor.
pub(crate) fn rows(data: Vec<f32>, width: usize) -> Result<Tensor, MarlError> {
    let count = data.len() / width;
    Ok(Tensor::from_vec(data, (count, width), &Device::Cpu)?)
}
