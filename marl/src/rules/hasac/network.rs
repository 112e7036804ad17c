//! Networks with a batch norm before every linear layer: trained with the statistics of a batch, read with running ones.
//!
//! A batch norm and the linear layer after it are one linear map of the normalised rows, and, with constant statistics,
//! one linear map of the rows themselves: [`fold`] gives its parameters. A training pass takes one layer at a time
//! through all rows, because their statistics come first. Sums over rows are those of shards in their order, so that no
//! result depends on the number of threads.

use std::ops::Range;

use policy::Parameters;
use policy::layers::LayerSpec;
use policy::ops::{Activation, Input, Layer, LayerStack, Network, Packed, Workspace};
use rand::RngCore;
use rayon::prelude::*;

use crate::config::HasacConfig;
use crate::error::MarlError;
use crate::optimisation::gradient::Gradients;
use crate::optimisation::minibatch::split;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::rules::hasac::columns::{ColumnMoments, ColumnSums, Normalisation};
use crate::state::{Visitor, visit_numbers, visit_parameters};

/// Rows per shard on average, if there is more than one. With [`MAX_SHARDS`] it determines the order of sums.
const ROWS_PER_SHARD: usize = 128;
/// Maximum number of shards.
const MAX_SHARDS: usize = 16;

/// Shards of `rows` rows.
fn shards_of(rows: usize) -> Vec<Range<usize>> {
    split(rows, (rows / ROWS_PER_SHARD).clamp(1, MAX_SHARDS))
}

/// Layers of batch norm, Linear and ReLU, then a batch norm and a Linear, with their optimiser.
pub(super) struct NormalisedNetwork {
    parameters: Parameters,
    adam: Adam,
    momentum: f64,
    layers: Vec<NormalisedLayer>,
    /// Of the last training pass, `[shards][layers + 1]`: every layer's rows and the output.
    shards: Vec<Vec<LayerRows>>,
}

/// A batch norm and the linear layer after it.
struct NormalisedLayer {
    shape: LinearShape,
    /// Its parameters in the flat variable: scale and shift `[inputs]`, weight `[outputs, inputs]`, bias `[outputs]`.
    range: Range<usize>,
    running: ColumnMoments,
    /// Of the last training pass.
    normalisation: Normalisation,
    packed: Option<Packed>,
}

/// Sizes and activation of a linear layer.
#[derive(Clone, Copy)]
struct LinearShape {
    inputs: usize,
    outputs: usize,
    activation: Activation,
}

/// A shard's rows before one layer, in a training pass.
#[derive(Clone, Default)]
struct LayerRows {
    /// Normalised by the layer's batch norm; at the end, the output.
    rows: Vec<f32>,
    /// Gradient of the loss with respect to `rows`.
    gradient: Vec<f32>,
    /// Gradient with respect to the folded parameters.
    folded: Vec<f32>,
    workspace: Workspace,
}

impl LinearShape {
    fn layer(self) -> Layer {
        let Self { inputs, outputs, activation } = self;
        Layer::Linear { inputs, outputs, activation }
    }

    fn weights(self) -> usize {
        self.inputs * self.outputs
    }

    /// `gain` with which an orthogonal weight has the variance of PyTorch's initial weights, `1 / (3 inputs)`.
    fn gain(self) -> f64 {
        libm::sqrt(self.inputs.max(self.outputs) as f64 / (3 * self.inputs) as f64)
    }
}

/// Parameters of the linear map `W (scale x + shift) + b` of `x`: weight `W scale`, bias `b + W shift`.
fn fold(shape: LinearShape, linear: &[f32], scale: &[f32], shift: &[f32]) -> Vec<f32> {
    let (weight, bias) = linear.split_at(shape.weights());
    let rows = weight.chunks_exact(shape.inputs);
    let mut folded = Vec::with_capacity(linear.len());
    for row in rows.clone() {
        folded.extend(row.iter().zip(scale).map(|(weight, scale)| weight * scale));
    }
    let shifted = rows.zip(bias).map(|(row, &bias)| {
        let products = row.iter().zip(shift).map(|(&w, &s)| f64::from(w) * f64::from(s));
        (f64::from(bias) + products.sum::<f64>()) as f32
    });
    folded.extend(shifted);
    folded
}

impl NormalisedLayer {
    /// Parameters of the linear layer after normalisation by the batch, or on rows as they are with running statistics.
    fn folded(&self, parameters: &[f32], statistics: Option<&ColumnMoments>) -> Vec<f32> {
        let (norm, linear) = parameters[self.range.clone()].split_at(2 * self.shape.inputs);
        let (scale, shift) = norm.split_at(self.shape.inputs);
        let Some(ColumnMoments { mean, .. }) = statistics else {
            return fold(self.shape, linear, scale, shift);
        };
        let inverse = self.running.inverse_deviations();
        let scale: Vec<f32> = scale.iter().zip(&inverse).map(|(scale, x)| scale * x).collect();
        let shift = shift.iter().zip(&scale).zip(mean);
        let shift = shift.map(|((&b, &g), m)| (f64::from(b) - f64::from(g) * m) as f32);
        fold(self.shape, linear, &scale, &shift.collect::<Vec<_>>())
    }

    /// Writes the gradient of the layer's parameters, from that of the folded ones, and returns the means over `count`
    /// rows by which the normalisation's gradient is corrected: of the gradient, and of its product with the rows.
    fn gradient(
        &self,
        parameters: &[f32],
        folded: &[f32],
        count: usize,
        gradient: &mut [f32],
    ) -> [Vec<f32>; 2] {
        let inputs = self.shape.inputs;
        let (norm, linear) = parameters[self.range.clone()].split_at(2 * inputs);
        let (scale, shift) = norm.split_at(inputs);
        let (by_norm, by_linear) = gradient[self.range.clone()].split_at_mut(2 * inputs);
        let (by_weight, by_bias) = by_linear.split_at_mut(self.shape.weights());
        let (folded, biases) = folded.split_at(self.shape.weights());
        by_bias.copy_from_slice(biases);
        let mut sums = vec![[0.0_f64; 2]; inputs];
        let weights = linear.chunks_exact(inputs).zip(folded.chunks_exact(inputs));
        let rows = weights.zip(by_weight.chunks_exact_mut(inputs)).zip(biases);
        for (((weight, folded), by_weight), &bias) in rows {
            let columns = weight.iter().zip(folded).zip(scale.iter().zip(shift));
            for ((((&weight, &folded), (scale, shift)), by_weight), [by_scale, by_shift]) in
                columns.zip(by_weight).zip(&mut sums)
            {
                *by_weight = scale * folded + shift * bias;
                *by_scale += f64::from(folded * weight);
                *by_shift += f64::from(bias * weight);
            }
        }
        let share = 1.0 / count as f64;
        let mean = |sum: f64, scale: f32| (share * sum * f64::from(scale)) as f32;
        let (by_scale, by_shift) = by_norm.split_at_mut(inputs);
        for ((to, shift), [scale_sum, shift_sum]) in by_scale.iter_mut().zip(by_shift).zip(&sums) {
            (*to, *shift) = (*scale_sum as f32, *shift_sum as f32);
        }
        let means = |part: usize| sums.iter().zip(scale).map(move |(sum, &s)| mean(sum[part], s));
        [means(1).collect(), means(0).collect()]
    }
}

impl NormalisedNetwork {
    /// `layers` hidden layers of `width` units, and their optimiser. `own` has the momentum of the running statistics and
    /// the decay of the optimiser's first moment.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(super) fn new(
        (inputs, width, layers, outputs): (usize, usize, usize, usize),
        (adam, own): (AdamConfig, &HasacConfig),
        rng: &mut impl RngCore,
    ) -> Result<Self, MarlError> {
        let shape = |layer: usize| LinearShape {
            inputs: if layer == 0 { inputs } else { width },
            outputs: if layer == layers { outputs } else { width },
            activation: if layer == layers { Activation::Identity } else { Activation::Relu },
        };
        let mut parameters = Parameters::new();
        let (mut specs, mut declared, mut end) = (Vec::new(), Vec::new(), 0);
        for (layer, shape) in (0..=layers).map(|layer| (layer, shape(layer))) {
            let LinearShape { inputs, outputs, activation } = shape;
            let linear = format!("layers.{layer}.linear");
            specs.push(LayerSpec::norm(&format!("layers.{layer}.norm"), inputs));
            specs.push(LayerSpec::linear(&linear, (inputs, outputs), activation, shape.gain()));
            let start = end;
            end += 2 * inputs + shape.layer().parameters();
            let running = ColumnMoments::standard(inputs);
            let normalisation = Normalisation::default();
            let packed = None;
            declared.push(NormalisedLayer {
                shape,
                range: start..end,
                running,
                normalisation,
                packed,
            });
        }
        LayerStack::declare(&mut parameters, &specs, rng)?;
        let adam = Adam::new(adam, &parameters).with_first_decay(own.first_moment);
        let momentum = own.norm_momentum;
        Ok(Self { parameters, adam, momentum, layers: declared, shards: Vec::new() })
    }

    /// Width of an input row.
    pub(super) fn inputs(&self) -> usize {
        self.layers[0].shape.inputs
    }

    pub(super) fn scale_learning_rate(&mut self, share: f64) {
        self.adam.scale_learning_rate(share);
    }

    /// Number of steps skipped because their gradient was not finite.
    pub(super) fn skipped(&self) -> i64 {
        self.adam.skipped()
    }

    /// The output `[R, outputs]` for `rows` `[R, inputs]` with the statistics of these rows, which the running ones then
    /// follow.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(super) fn forward(&mut self, rows: &[f32]) -> Result<Vec<f32>, MarlError> {
        let parameters = self.parameters.values()?.concat();
        let Self { layers, shards, momentum, .. } = self;
        let inputs = layers[0].shape.inputs;
        let count = rows.len() / inputs;
        let ranges = shards_of(count);
        shards.resize_with(ranges.len(), || vec![LayerRows::default(); layers.len() + 1]);
        let mut sums: Vec<ColumnSums> = shards
            .par_iter_mut()
            .zip(ranges)
            .map(|(shard, range)| {
                let first = &mut shard[0].rows;
                first.clear();
                first.extend_from_slice(&rows[range.start * inputs..range.end * inputs]);
                ColumnSums::of(first, inputs)
            })
            .collect();
        for (index, layer) in layers.iter_mut().enumerate() {
            let moments = ColumnMoments::of(&sums, count);
            layer.running.follow(&moments, count, *momentum);
            layer.normalisation = Normalisation::by(&moments);
            let folded = layer.folded(&parameters, None);
            let packed = Packed::new(&Network::new(vec![layer.shape.layer()]), &folded);
            let forward = |shard: &mut Vec<LayerRows>| {
                let [own, next] = &mut shard[index..=index + 1] else {
                    unreachable!("every layer is followed by another or the output")
                };
                layer.normalisation.apply(&mut own.rows);
                packed.forward(Input { rows: &own.rows, sequences: None }, &mut own.workspace);
                next.rows.clear();
                own.workspace.append_output(&mut next.rows);
                ColumnSums::of(&next.rows, layer.shape.outputs)
            };
            sums = shards.par_iter_mut().map(forward).collect();
            layer.packed = Some(packed);
        }
        Ok(shards.iter().flat_map(|shard| &shard[layers.len()].rows).copied().collect())
    }

    /// Gradients of the parameters from that of the last [`Self::forward`]'s output, `[R, outputs]`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    ///
    /// # Panics
    /// If there was no forward pass of `R` rows since the last call.
    pub(super) fn backward(&mut self, output: &[f32]) -> Result<Gradients, MarlError> {
        let parameters = self.parameters.values()?.concat();
        let mut gradient = vec![0.0; parameters.len()];
        let Self { layers, shards, .. } = self;
        let mut rest = output;
        for last in shards.iter_mut().map(|shard| &mut shard[layers.len()]) {
            let (own, others) = rest.split_at(last.rows.len());
            last.gradient.clear();
            last.gradient.extend_from_slice(own);
            rest = others;
        }
        let count = output.len() / layers[layers.len() - 1].shape.outputs;
        for (index, layer) in layers.iter_mut().enumerate().rev() {
            let packed = layer.packed.take().expect("a forward pass comes before");
            let backward = |shard: &mut Vec<LayerRows>| {
                let [own, next] = &mut shard[index..=index + 1] else {
                    unreachable!("every layer is followed by another or the output")
                };
                let LayerRows { gradient, folded, workspace, .. } = own;
                gradient.clear();
                folded.clear();
                folded.resize(packed.network().parameters(), 0.0);
                let by_rows = (index > 0).then_some(gradient);
                packed.backward(&next.gradient, None, workspace, Some(folded), by_rows);
            };
            shards.par_iter_mut().for_each(backward);
            let mut total = shards[0][index].folded.clone();
            for shard in &shards[1..] {
                total.iter_mut().zip(&shard[index].folded).for_each(|(sum, x)| *sum += x);
            }
            let means = layer.gradient(&parameters, &total, count, &mut gradient);
            if index > 0 {
                shards.par_iter_mut().for_each(|shard| {
                    let LayerRows { rows, gradient, .. } = &mut shard[index];
                    layer.normalisation.gradient(gradient, rows, [&means[0], &means[1]]);
                });
            }
        }
        Ok(Gradients(vec![gradient]))
    }

    /// One descent step along [`Self::backward`]; returns the gradient's norm. A gradient that is not finite is skipped.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(super) fn descend(&mut self, output: &[f32]) -> Result<f64, MarlError> {
        let gradients = self.backward(output)?;
        self.adam.step(&self.parameters, &gradients)
    }

    /// Parameters of the same network with running statistics and without norms: for every layer the weight
    /// `[outputs, inputs]` and the bias.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(super) fn folded(&self) -> Result<Vec<f32>, MarlError> {
        let parameters = self.parameters.values()?.concat();
        let one = |layer: &NormalisedLayer| layer.folded(&parameters, Some(&layer.running));
        Ok(self.layers.iter().flat_map(one).collect())
    }

    /// The current network with running statistics, for reading.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(super) fn frozen(&self) -> Result<FrozenNetwork, MarlError> {
        let layers = self.layers.iter().map(|layer| layer.shape.layer()).collect();
        let packed = Packed::new(&Network::new(layers), &self.folded()?);
        Ok(FrozenNetwork { packed, shards: Vec::new() })
    }

    /// Visits `weights/NAME.*`, `normalizer/NAME.*` and `optimizer/NAME.*`.
    pub(super) fn visit(&mut self, name: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        visit_parameters(visitor, &format!("weights/{name}."), &self.parameters)?;
        for (index, layer) in self.layers.iter_mut().enumerate() {
            let prefix = format!("normalizer/{name}.layers.{index}.");
            visit_numbers(visitor, &format!("{prefix}mean"), &mut layer.running.mean)?;
            visit_numbers(visitor, &format!("{prefix}variance"), &mut layer.running.variance)?;
            let invalid = |x: &f64| !x.is_finite() || *x < 0.0;
            if let Some(found) = layer.running.variance.iter().find(|x| invalid(x)) {
                return Err(MarlError::Restore(format!("{prefix}variance has {found}")));
            }
        }
        self.adam.visit(&format!("optimizer/{name}."), visitor)
    }
}

/// A network with constant statistics, folded into its linear layers.
pub(super) struct FrozenNetwork {
    packed: Packed,
    /// Buffers of the last forward pass.
    shards: Vec<Workspace>,
}

impl FrozenNetwork {
    /// The output `[R, outputs]` for `rows` `[R, inputs]`.
    pub(super) fn forward(&mut self, rows: &[f32]) -> Vec<f32> {
        let inputs = self.packed.network().inputs();
        let ranges = shards_of(rows.len() / inputs);
        self.shards.resize_with(ranges.len(), Workspace::default);
        let packed = &self.packed;
        let one = |(workspace, range): (&mut Workspace, Range<usize>)| {
            let rows = &rows[range.start * inputs..range.end * inputs];
            packed.forward(Input { rows, sequences: None }, workspace);
            let mut output = Vec::new();
            workspace.append_output(&mut output);
            output
        };
        self.shards.par_iter_mut().zip(ranges).map(one).collect::<Vec<_>>().concat()
    }

    /// Gradient of the last forward pass's rows, `[R, inputs]`, from that of its output.
    pub(super) fn input_gradient(&mut self, output: &[f32]) -> Vec<f32> {
        let outputs = self.packed.network().outputs();
        let ranges = shards_of(output.len() / outputs);
        let packed = &self.packed;
        let one = |(workspace, range): (&mut Workspace, Range<usize>)| {
            let output = &output[range.start * outputs..range.end * outputs];
            let mut gradient = Vec::new();
            packed.backward(output, None, workspace, None, Some(&mut gradient));
            gradient
        };
        self.shards.par_iter_mut().zip(ranges).map(one).collect::<Vec<_>>().concat()
    }
}

#[cfg(test)]
mod tests;
