//! The critic: values of global states.

mod loss;
mod mode;
mod recurrent;
mod state_scale;
pub mod value_normalizer;

use std::ops::Range;

use candle_core::Tensor;
use policy::InputNorm;
use policy::layers::LayerSpec;
use policy::ops::{LayerStack, Weights};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};

use crate::config::{CriticConfig, CriticCore};
pub(crate) use crate::critic::loss::explained_variance;
use crate::critic::loss::mean_explained;
pub use crate::critic::loss::value_loss;
pub(crate) use crate::critic::mode::CriticMode;
use crate::critic::recurrent::{Memory, SequenceStart, Unrolled};
pub(crate) use crate::critic::state_scale::StateScale;
use crate::critic::value_normalizer::ValueNormalizer;
use crate::data::batch::Batch;
use crate::data::sequence::ChunkLayout;
use crate::error::MarlError;
use crate::objective::advantage::next_values;
use crate::optimisation::gradient::{Gradients, OutputGradient, numbers, root};
use crate::optimisation::layers::{Normalisation, rectified_layers, rows};
use crate::optimisation::minibatch::minibatches;
use crate::optimisation::optimizer::Adam;
use crate::optimisation::shards::{self, shards};
use crate::rounding::round;
use crate::shape::assert_shape;
use crate::state::{Visitor, visit_parameters};

/// [`InputNorm`], then layers of Linear, ReLU, LayerNorm, then a GRU with its LayerNorm if configured, then `V` values,
/// each normalised by its own returns. [`CriticMode`] selects the valued rewards.
pub(crate) struct Critic {
    config: CriticConfig,
    seed: RunSeed,
    /// Number of values, `V`.
    count: usize,
    /// Features of a state, `S`.
    inputs: usize,
    scale: StateScale,
    parameters: Parameters,
    layers: LayerStack,
    adam: Adam,
    normalizers: Vec<ValueNormalizer>,
    /// `None` with `core = mlp`.
    memory: Option<Memory>,
}

/// A critic's values of a batch before it is trained on it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Values {
    /// Normalised values, the network's output, `[T * B, V]`.
    pub normalized: Vec<f64>,
    /// Value of every row's state, `[V][T, B]`, in units of the return.
    pub now: Vec<Vec<f64>>,
    /// Value of every row's true next state, `[V][T, B]`; 0 after a termination.
    pub next: Vec<Vec<f64>>,
    /// Sequences on which the critic is fitted: chunks of truncated back-propagation, or single rows without memory.
    pub layout: ChunkLayout,
    /// `None` without memory.
    pub unrolled: Option<Unrolled>,
}

/// Metrics of a fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct CriticFigures {
    /// Mean loss over all optimiser steps, squared normalised units.
    pub loss: f64,
    /// Mean gradient norm before clipping.
    pub gradient_norm: f64,
    /// Explained variance of the returns before the fit, mean over values.
    pub explained_variance: f64,
    /// Number of steps skipped because their gradient was not finite.
    pub skipped: i64,
}

/// Constants of a fit, for all rows.
#[derive(Clone, Copy)]
struct FitData<'a> {
    /// States, `[T * B, S]`.
    rows: &'a [f32],
    /// Before the fit.
    values: &'a Values,
    /// Normalised returns, `[T * B, V]`.
    target: &'a [f64],
}

impl Critic {
    /// A critic with `count` values of states of `inputs` features. `adam_epsilon` and `chunk_steps`, the steps of
    /// truncated back-propagation, are the actors'.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn new(
        config: &CriticConfig,
        (adam_epsilon, chunk_steps): (f64, usize),
        (inputs, count): (usize, usize),
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::CriticInitialisation));
        let mut specs = Vec::new();
        if config.input_norm == InputNorm::LayerNorm {
            specs.push(LayerSpec::norm("norm", inputs));
        }
        let shape = (inputs, config.width, config.layers);
        specs.extend(rectified_layers(shape, Normalisation::LayerNorm, count));
        let memory = match config.core {
            CriticCore::Mlp => None,
            CriticCore::Gru => Some(Memory::declare(&mut specs, config.width, chunk_steps)),
        };
        let mut parameters = Parameters::new();
        let layers = LayerStack::declare(&mut parameters, &specs, &mut rng)?;
        Ok(Self {
            config: config.clone(),
            seed,
            count,
            inputs,
            scale: StateScale::new(config.state_norm, inputs),
            adam: Adam::new(config.adam(adam_epsilon), &parameters),
            parameters,
            layers,
            normalizers: vec![ValueNormalizer::new(config.normalizer_beta); count],
            memory,
        })
    }

    /// Sets the fraction of the configured learning rate for the next steps.
    pub(crate) fn scale_learning_rate(&mut self, share: f64) {
        self.adam.scale_learning_rate(share);
    }

    /// Normalised values `[R, V]` of states `[R, S]`; with a memory these are the sequences that begin in `start`.
    fn forward(
        &self,
        weights: &Weights,
        mut states: Vec<f32>,
        start: Option<&SequenceStart>,
    ) -> Result<Tensor, MarlError> {
        self.scale.apply(&mut states, self.inputs);
        let input = rows(states, self.inputs)?;
        Ok(weights.apply(&input, start.map(SequenceStart::input))?)
    }

    /// As [`Critic::forward`] without memory, in f64.
    fn forward_all(&self, states: &[f32]) -> Result<Vec<f64>, MarlError> {
        let weights = self.layers.constant_weights()?;
        let one = |range: Range<usize>| {
            let part = &states[range.start * self.inputs..range.end * self.inputs];
            numbers(&self.forward(&weights, part.to_vec(), None)?)
        };
        Ok(shards::of_each(&shards(states.len() / self.inputs, 1), one)?.concat())
    }

    /// Values before every step of `batch` and of the true next states.
    ///
    /// # Errors
    /// If the memory is that of another number of environments, or a tensor operation fails.
    ///
    /// # Panics
    /// If the states do not have the shapes of `batch`.
    pub(crate) fn values(&self, batch: &Batch) -> Result<Values, MarlError> {
        let finals: Vec<f32> = batch.finals.iter().flat_map(|last| &last.state).copied().collect();
        assert_shape("states", batch.state.len(), batch.rows() * self.inputs);
        assert_shape("final states", finals.len(), batch.finals.len() * self.inputs);
        let (layout, normalized, finals, unrolled) = match &self.memory {
            None => (
                ChunkLayout::of(batch, 1),
                self.forward_all(&batch.state)?,
                self.forward_all(&finals)?,
                None,
            ),
            Some(memory) => {
                let (normalized, finals, unrolled) = self.unroll(memory, batch, &finals)?;
                (memory.layout(batch), normalized, finals, Some(unrolled))
            }
        };
        let (mut now, mut next) = (Vec::new(), Vec::new());
        for head in 0..self.count {
            let own = self.of_head(&normalized, head);
            next.push(next_values(batch, &own, &self.of_head(&finals, head)));
            now.push(own);
        }
        Ok(Values { normalized, now, next, layout, unrolled })
    }

    /// Column `head` of `[R, V]` normalised values, in units of the return.
    fn of_head(&self, normalized: &[f64], head: usize) -> Vec<f64> {
        let column = normalized.iter().skip(head).step_by(self.count);
        let value = |&value: &f64| self.normalizers[head].denormalize(value);
        column.map(|normal| round(value(normal))).collect()
    }

    /// Keeps the recurrent states in which the rollout of `values` ended for the next rollout.
    pub(crate) fn carry(&mut self, values: &Values) {
        if let (Some(memory), Some(unrolled)) = (&mut self.memory, &values.unrolled) {
            memory.carry(unrolled);
        }
    }

    /// Forgets the recurrent state of an environment, which begins a new episode.
    pub(crate) fn forget(&mut self, environment: usize) {
        if let Some(memory) = &mut self.memory {
            memory.forget(environment);
        }
    }

    /// Trains on the returns `[V][T, B]`; `values` are those before the fit.
    ///
    /// # Errors
    /// If a tensor operation fails.
    ///
    /// # Panics
    /// If the shapes of `batch`, `values` and `returns` differ.
    pub(crate) fn fit(
        &mut self,
        batch: &Batch,
        values: &Values,
        returns: &[Vec<f64>],
        iteration: u64,
    ) -> Result<CriticFigures, MarlError> {
        let count = values.layout.rows();
        assert_shape("states", batch.state.len(), count * self.inputs);
        assert_shape("values", values.normalized.len(), count * self.count);
        assert_shape("returns", returns.iter().map(Vec::len).collect(), vec![count; self.count]);
        for (normalizer, returns) in self.normalizers.iter_mut().zip(returns) {
            normalizer.update(returns);
        }
        let target = self.targets(returns);
        let data = FitData { rows: &batch.state, values, target: &target };
        let mut figures = CriticFigures::default();
        for epoch in 0..self.config.epochs {
            let draw = Draw::of(Purpose::CriticMinibatch).iteration(iteration).step(epoch as u32);
            let (chunks, parts) = (values.layout.chunks, self.config.minibatches);
            let parts = minibatches(chunks, parts, self.seed, draw);
            let weight = 1.0 / (self.config.epochs * parts.len()) as f64;
            for part in parts {
                let (loss, norm) = self.step(data, &part)?;
                figures.loss += weight * loss;
                figures.gradient_norm += weight * norm;
            }
        }
        figures.explained_variance = mean_explained(&values.now, returns);
        figures.skipped = self.adam.skipped();
        // After the fit, so that old and new values use the same scaling.
        self.scale.take_in(&batch.state);
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

    /// An optimiser step on the sequences `part`.
    fn step(&mut self, data: FitData<'_>, part: &[usize]) -> Result<(f64, f64), MarlError> {
        let weights = self.layers.weights()?;
        let total = part.len();
        let one = |range: Range<usize>| self.gradient(&weights, data, &part[range], total);
        let (loss, gradients) = shards::sum(&shards(total, data.values.layout.steps), &one)?;
        Ok((loss, self.adam.step(&self.parameters, &gradients)?))
    }

    /// Loss of some sequences of `total`, and its gradient.
    fn gradient(
        &self,
        weights: &Weights,
        FitData { rows, values, target }: FitData<'_>,
        part: &[usize],
        total: usize,
    ) -> Result<(f64, Gradients), MarlError> {
        let (width, layout) = (self.inputs, values.layout);
        let order = layout.sources(part);
        let states = order.iter().flat_map(|&row| &rows[row * width..(row + 1) * width]);
        let start = values.unrolled.as_ref();
        let start = start.map(|states| states.start(layout, part)).transpose()?;
        let output = self.forward(weights, states.copied().collect(), start.as_ref())?;
        let found = numbers(&output)?;
        let share = 1.0 / (total * layout.steps * self.count) as f64;
        let CriticConfig { clip, huber_delta, .. } = self.config;
        let places = order.iter().flat_map(|&row| row * self.count..(row + 1) * self.count);
        let mut loss = 0.0;
        let mut gradient = Vec::with_capacity(found.len());
        for (&value, place) in found.iter().zip(places) {
            let old = values.normalized[place];
            let (own, slope) = value_loss(value, old, target[place], clip, huber_delta);
            loss += share * own;
            gradient.push(share * slope);
        }
        let root = root(&[OutputGradient { output: &output, gradient: &gradient }])?;
        Ok((loss, Gradients::of(&self.parameters, &root)?))
    }

    /// Visits `weights/critic.*`, `optimizer/critic.*`, `normalizer/value_I`, `normalizer/state.*`, `memory/critic.hidden`.
    pub(crate) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        visit_parameters(visitor, "weights/critic.", &self.parameters)?;
        self.adam.visit("optimizer/critic.", visitor)?;
        self.scale.visit("normalizer/state.", visitor)?;
        for (agent, normalizer) in self.normalizers.iter_mut().enumerate() {
            normalizer.visit(&format!("normalizer/value_{agent}"), visitor)?;
        }
        let memory = self.memory.as_mut();
        memory.map_or(Ok(()), |memory| memory.visit("memory/critic.hidden", visitor))
    }
}
