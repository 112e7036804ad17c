//! The critic: values of global states or observations.

mod mode;
mod state_scale;
mod team;
pub mod value_normalizer;

use std::ops::Range;

use candle_core::Tensor;
use policy::arrays::{Array, NamedArrays};
use policy::layers::LayerSpec;
use policy::ops::{LayerStack, Weights};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{InputNorm, Precision};
use rayon::prelude::*;

use crate::config::CriticConfig;
pub(crate) use crate::critic::state_scale::StateScale;
pub(crate) use crate::critic::team::Critics;
use crate::critic::value_normalizer::ValueNormalizer;
use crate::data::batch::Batch;
use crate::error::MarlError;
use crate::objective::advantage::next_values;
use crate::objective::surrogate::mean_and_deviation;
use crate::optimisation::gradient::{Gradients, OutputGradient, numbers, root};
use crate::optimisation::layers::{Normalisation, rectified_layers, rows};
use crate::optimisation::minibatch::minibatches;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::optimisation::shards::{self, shards};
use crate::shape::assert_shape;

/// [`InputNorm`], then layers of Linear, ReLU, LayerNorm, then `V` values, each normalised by its own returns.
/// [`CriticMode`](crate::config::CriticMode) selects the valued rewards.
pub struct Critic {
    config: CriticConfig,
    seed: RunSeed,
    precision: Precision,
    /// Suffix of the names of its arrays.
    suffix: String,
    /// Index of the critic, which is also the index of its first value.
    index: u32,
    /// Number of values, `V`.
    count: usize,
    inputs: usize,
    scale: StateScale,
    parameters: Parameters,
    layers: LayerStack,
    adam: Adam,
    normalizers: Vec<ValueNormalizer>,
}

/// A critic's input for a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct ValueInputs<'a> {
    /// Before every step, `[T * B, S]`.
    pub rows: &'a [f32],
    /// After the steps of the batch's finals, `[F, S]`.
    pub finals: Vec<f32>,
}

/// A critic's values of a batch before it is trained on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// Normalised values, the network's output, `[T * B, V]`.
    pub normalized: Vec<f64>,
    /// Value of every row's state, `[V][T, B]`, in units of the return.
    pub now: Vec<Vec<f64>>,
    /// Value of every row's true next state, `[V][T, B]`; 0 after a termination.
    pub next: Vec<Vec<f64>>,
}

/// Metrics of a fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CriticFigures {
    /// Mean loss over all optimiser steps, squared normalised units.
    pub loss: f64,
    /// Mean gradient norm before clipping.
    pub gradient_norm: f64,
    /// Explained variance of the returns before the fit, mean over values.
    pub explained_variance: f64,
    /// Number of steps skipped because their gradient was not finite.
    pub skipped: i64,
}

/// Huber's loss of an error and its derivative: `e^2 / 2` within `delta`, linear beyond.
#[must_use]
pub fn huber(error: f64, delta: f64) -> (f64, f64) {
    if error.abs() <= delta {
        (0.5 * error * error, error)
    } else {
        (delta * (error.abs() - 0.5 * delta), delta * error.signum())
    }
}

/// The clipped value loss of one element, `max(huber(v - R), huber(v_clip - R))` with
/// `v_clip = v_old + clamp(v - v_old, +-clip)`, and its derivative with respect to `v`; in normalised units. With
/// `clip` = 0 the loss is `huber(v - R)`.
#[must_use]
pub fn value_loss(value: f64, old: f64, target: f64, clip: f64, delta: f64) -> (f64, f64) {
    let change = value - old;
    let free = huber(value - target, delta);
    if clip == 0.0 {
        return free;
    }
    let clipped = huber(old + change.clamp(-clip, clip) - target, delta);
    match clipped.0 > free.0 {
        true => (clipped.0, if change.abs() <= clip { clipped.1 } else { 0.0 }),
        false => free,
    }
}

/// Constants of a fit, for all rows.
#[derive(Clone, Copy)]
struct FitData<'a> {
    /// Inputs, `[T * B, S]`.
    rows: &'a [f32],
    /// Normalised values before the fit, `[T * B, V]`.
    old: &'a [f64],
    /// Normalised returns, `[T * B, V]`.
    target: &'a [f64],
}

impl Critic {
    /// A critic with `count` values of `inputs` features. `suffix` and `index` identify the critic among an algorithm's
    /// critics; `adam_epsilon` is the actors'.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub fn new(
        config: &CriticConfig,
        adam_epsilon: f64,
        (suffix, index): (&str, u32),
        (inputs, count): (usize, usize),
        (seed, precision): (RunSeed, Precision),
    ) -> Result<Self, MarlError> {
        let draw = Draw::of(Purpose::CriticInitialisation).agent(index);
        let mut rng = generator(seed, draw);
        let mut specs = Vec::new();
        if config.input_norm == InputNorm::LayerNorm {
            specs.push(LayerSpec::norm("norm", inputs));
        }
        let shape = (inputs, config.width, config.layers);
        specs.extend(rectified_layers(shape, Normalisation::LayerNorm, count));
        let mut parameters = Parameters::new();
        let layers = LayerStack::declare(&mut parameters, &specs, precision.dtype(), &mut rng)?;
        let adam = AdamConfig {
            learning_rate: config.learning_rate,
            epsilon: adam_epsilon,
            max_gradient_norm: config.max_gradient_norm,
        };
        Ok(Self {
            config: config.clone(),
            seed,
            precision,
            suffix: suffix.to_owned(),
            index,
            count,
            inputs,
            scale: StateScale::new(config.state_norm, inputs),
            adam: Adam::new(adam, &parameters),
            parameters,
            layers,
            normalizers: vec![ValueNormalizer::new(config.normalizer_beta); count],
        })
    }

    /// Sets the fraction of the configured learning rate for the next steps.
    pub fn scale_learning_rate(&mut self, share: f64) {
        self.adam.scale_learning_rate(share);
    }

    /// Normalised values `[R, V]` of states `[R, S]`.
    fn forward(&self, weights: &Weights, mut states: Vec<f32>) -> Result<Tensor, MarlError> {
        self.scale.apply(&mut states, self.inputs);
        Ok(weights.apply(&rows(states, self.inputs, self.precision)?, None)?)
    }

    /// As [`Critic::forward`], in f64.
    fn forward_all(&self, states: &[f32]) -> Result<Vec<f64>, MarlError> {
        let weights = self.layers.constant_weights()?;
        let one = |range: Range<usize>| {
            let part = &states[range.start * self.inputs..range.end * self.inputs];
            numbers(&self.forward(&weights, part.to_vec())?)
        };
        Ok(shards::of_each(&shards(states.len() / self.inputs, 1), one)?.concat())
    }

    /// Values before every step of `batch` and of the true next states.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub fn values(&self, batch: &Batch, inputs: &ValueInputs<'_>) -> Result<Values, MarlError> {
        let (normalized, finals) =
            (self.forward_all(inputs.rows)?, self.forward_all(&inputs.finals)?);
        let (mut now, mut next) = (Vec::new(), Vec::new());
        for head in 0..self.count {
            let own = self.of_head(&normalized, head);
            next.push(next_values(batch, &own, &self.of_head(&finals, head)));
            now.push(own);
        }
        Ok(Values { normalized, now, next })
    }

    /// Column `head` of `[R, V]` normalised values, in units of the return.
    fn of_head(&self, normalized: &[f64], head: usize) -> Vec<f64> {
        let column = normalized.iter().skip(head).step_by(self.count);
        let value = |&value: &f64| self.normalizers[head].denormalize(value);
        column.map(|normal| self.precision.round(value(normal))).collect()
    }

    /// Trains on the returns `[V][T, B]`; `values` are those before the fit.
    ///
    /// # Errors
    /// If a tensor operation fails.
    ///
    /// # Panics
    /// If returns and values have different shapes.
    pub fn fit(
        &mut self,
        inputs: &ValueInputs<'_>,
        values: &Values,
        returns: &[Vec<f64>],
        iteration: u64,
    ) -> Result<CriticFigures, MarlError> {
        let count = values.now[0].len();
        let shapes: Vec<usize> = returns.iter().map(Vec::len).collect();
        assert_shape("returns", shapes, vec![count; self.count]);
        for (normalizer, returns) in self.normalizers.iter_mut().zip(returns) {
            normalizer.update(returns);
        }
        let target = self.targets(returns);
        let mut figures = CriticFigures::default();
        let weight = 1.0 / (self.config.epochs * self.config.minibatches) as f64;
        for epoch in 0..self.config.epochs {
            let draw = Draw::of(Purpose::CriticMinibatch).iteration(iteration);
            let draw = draw.step(epoch as u32).agent(self.index);
            for part in minibatches(count, self.config.minibatches, self.seed, draw) {
                let (loss, norm) = self.step(inputs.rows, &values.normalized, &target, &part)?;
                figures.loss += weight * loss;
                figures.gradient_norm += weight * norm;
            }
        }
        figures.explained_variance = mean_explained(self.precision, &values.now, returns);
        figures.skipped = self.adam.skipped();
        // After the fit, so that old and new values use the same scaling.
        self.scale.take_in(inputs.rows);
        Ok(figures)
    }

    /// Normalised returns, `[T * B, V]`.
    fn targets(&self, returns: &[Vec<f64>]) -> Vec<f64> {
        let row = |row: usize| {
            let agents = self.normalizers.iter().zip(returns);
            agents.map(move |(normalizer, returns)| normalizer.normalize(returns[row]))
        };
        (0..returns[0].len()).flat_map(row).collect()
    }

    fn step(
        &mut self,
        rows: &[f32],
        old: &[f64],
        target: &[f64],
        part: &[usize],
    ) -> Result<(f64, f64), MarlError> {
        let weights = self.layers.weights()?;
        let (total, data) = (part.len(), FitData { rows, old, target });
        let one = |range: Range<usize>| self.gradient(&weights, data, &part[range], total);
        let (loss, gradients) = shards::sum(&shards(total, 1), &one)?;
        Ok((loss, self.adam.step(&self.parameters, &gradients)?))
    }

    /// Loss of some rows of `total`, and its gradient.
    fn gradient(
        &self,
        weights: &Weights,
        FitData { rows, old, target }: FitData<'_>,
        part: &[usize],
        total: usize,
    ) -> Result<(f64, Gradients), MarlError> {
        let width = self.inputs;
        let states = part.iter().flat_map(|&row| &rows[row * width..(row + 1) * width]);
        let output = self.forward(weights, states.copied().collect())?;
        let found = numbers(&output)?;
        let share = 1.0 / (total * self.count) as f64;
        let CriticConfig { clip, huber_delta, .. } = self.config;
        let places = part.iter().flat_map(|&row| row * self.count..(row + 1) * self.count);
        let (mut loss, mut gradient) = (0.0, Vec::with_capacity(found.len()));
        for (&value, place) in found.iter().zip(places) {
            let (own, slope) = value_loss(value, old[place], target[place], clip, huber_delta);
            loss += share * own;
            gradient.push(share * slope);
        }
        let root = root(&[OutputGradient { output: &output, gradient: &gradient }])?;
        Ok((loss, Gradients::of(&self.parameters, &root)?))
    }

    /// `weights/critic*.*`, `optimizer/critic*.*`, `normalizer/value_I`, `normalizer/state*.*`; the first `*` is the
    /// suffix.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub fn arrays(&self) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.parameters.to_arrays(&format!("weights/critic{}.", self.suffix))?;
        arrays.append(&mut self.adam.arrays(&format!("optimizer/critic{}.", self.suffix)));
        arrays.append(&mut self.scale.arrays(&format!("normalizer/state{}.", self.suffix)));
        for (agent, normalizer) in (self.index..).zip(&self.normalizers) {
            let array = Array::F64 { shape: vec![3], data: normalizer.state().to_vec() };
            arrays.insert(format!("normalizer/value_{agent}"), array);
        }
        Ok(arrays)
    }

    /// Restores the output of [`Critic::arrays`].
    ///
    /// # Errors
    /// Names an array that is missing or of another shape or type.
    pub fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError> {
        self.parameters.load(&format!("weights/critic{}.", self.suffix), arrays)?;
        self.adam.restore(&format!("optimizer/critic{}.", self.suffix), arrays)?;
        self.scale.restore(&format!("normalizer/state{}.", self.suffix), arrays)?;
        for (agent, normalizer) in (self.index..).zip(&mut self.normalizers) {
            let name = format!("normalizer/value_{agent}");
            match arrays.get(&name) {
                Some(Array::F64 { data, .. }) if data.len() == 3 => {
                    normalizer.restore([data[0], data[1], data[2]]);
                }
                _ => return Err(MarlError::Restore(format!("{name} is not 3 f64 numbers"))),
            }
        }
        Ok(())
    }
}

/// `1 - Var(R - V) / Var(R)` of values and returns `[T, B]`; 0 for constant returns.
///
/// # Panics
/// If the shapes differ.
#[must_use]
pub fn explained_variance(precision: Precision, values: &[f64], returns: &[f64]) -> f64 {
    assert_shape("values", values.len(), returns.len());
    let rest = precision.rounded(returns.iter().zip(values).map(|(r, v)| r - v).collect());
    let (spread, left) = (mean_and_deviation(returns).1, mean_and_deviation(&rest).1);
    if spread > 0.0 { 1.0 - (left * left) / (spread * spread) } else { 0.0 }
}

/// Mean of [`explained_variance`] over `[V][T, B]`.
fn mean_explained(precision: Precision, values: &[Vec<f64>], returns: &[Vec<f64>]) -> f64 {
    let one =
        |(values, returns): (&Vec<f64>, &Vec<f64>)| explained_variance(precision, values, returns);
    let shares: Vec<f64> = values.par_iter().zip(returns).map(one).collect();
    shares.iter().sum::<f64>() / shares.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hubers_loss_matches_worked_cases_on_both_sides_of_delta() {
        assert_eq!(huber(3.0, 10.0), (4.5, 3.0));
        assert_eq!(huber(-12.0, 10.0), (70.0, -10.0)); // 10 (12 - 5)
        assert_eq!(huber(10.0, 10.0), (50.0, 10.0));
    }

    #[test]
    fn the_clipped_value_loss_is_the_larger_of_the_two_losses() {
        // Unchanged value: plain squared error.
        assert_eq!(value_loss(1.0, 1.0, 3.0, 0.2, 10.0), (2.0, -2.0));
        // Beyond the clip towards the target: clamped at .2, whose loss is larger; derivative 0.
        let (loss, slope) = value_loss(2.0, 1.0, 3.0, 0.2, 10.0);
        assert!((loss - 0.5 * 1.8 * 1.8).abs() < 1e-12 && slope == 0.0);
        // Beyond the clip away from the target: the unclipped loss is larger and has a derivative.
        assert_eq!(value_loss(0.0, 1.0, 3.0, 0.2, 10.0), (4.5, -3.0));
        // Without clipping the old value has no effect.
        assert_eq!(value_loss(2.0, 1.0, 3.0, 0.0, 10.0), (0.5, -1.0));
    }

    #[test]
    fn values_equal_to_the_returns_have_an_explained_variance_of_one() {
        let (double, returns) = (Precision::Double, [1.0, 2.0, 3.0]);
        assert_eq!(explained_variance(double, &returns, &returns), 1.0);
        assert_eq!(explained_variance(double, &[2.0; 3], &returns), 0.0);
        let (both, known) = (vec![returns.to_vec(); 2], vec![returns.to_vec(), vec![2.0; 3]]);
        assert_eq!(mean_explained(double, &known, &both), 0.5);
    }
}
