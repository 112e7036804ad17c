//! The memory of a recurrent critic: a GRU whose state is carried along each environment's steps, within a rollout and
//! from one to the next, and is zeros where an episode begins.
//!
//! Values before an update come from one pass over the whole rollout with the weights before it. The fit starts every
//! chunk of truncated back-propagation from the state of that pass, a constant, as an actor's does.

use std::ops::Range;

use candle_core::{Device, Tensor};
use policy::layers::LayerSpec;
use policy::ops::{RecurrentInput, Weights};

use super::Critic;
use crate::data::batch::Batch;
use crate::data::sequence::{ChunkLayout, mask};
use crate::error::MarlError;
use crate::optimisation::gradient::numbers;
use crate::optimisation::layers::rows;
use crate::optimisation::shards::{self, shards};
use crate::shape::assert_shape;
use crate::state::{ArrayShape, Elements, Visitor};

/// Recurrent states between two rollouts.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    /// `H`, recurrent units.
    width: usize,
    /// `L`, steps of truncated back-propagation.
    chunk_steps: usize,
    /// State before the next rollout's first step, `[B, H]`; empty before the first rollout, which starts from zeros.
    carried: Vec<f32>,
}

/// Recurrent states and resets of a rollout, computed with the weights before the update.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Unrolled {
    /// `H`, recurrent units.
    width: usize,
    /// State before each chunk's first step, after any reset, `[C, H]`.
    starts: Vec<f32>,
    /// 0 where an episode has just begun inside a chunk, else 1, `[L, C]`.
    mask: Vec<f32>,
    /// State after the rollout's last step, zeros where an episode ended with it, `[B, H]`.
    last: Vec<f32>,
}

/// Start states and resets of some sequences, as tensors.
pub(super) struct SequenceStart {
    /// `[P, H]`
    states: Tensor,
    /// `[L, P]`
    mask: Tensor,
}

impl Memory {
    /// Adds a GRU of `width` units and a LayerNorm before the last of the layers `specs`, as HARL does.
    pub(super) fn declare(specs: &mut Vec<LayerSpec>, width: usize, chunk_steps: usize) -> Self {
        let value = specs.pop();
        specs.push(LayerSpec::gru("gru", width, width));
        specs.push(LayerSpec::norm("gru_norm", width));
        specs.extend(value);
        Self { width, chunk_steps, carried: Vec::new() }
    }

    /// Chunks of `batch`.
    pub(super) fn layout(&self, batch: &Batch) -> ChunkLayout {
        ChunkLayout::of(batch, self.chunk_steps)
    }

    /// State before the first step of `environments` environments, `[B, H]`.
    fn start(&self, environments: usize) -> Result<Vec<f32>, MarlError> {
        let expected = environments * self.width;
        match self.carried.len() {
            0 => Ok(vec![0.0; expected]),
            found if found == expected => Ok(self.carried.clone()),
            found => Err(MarlError::Batch(format!(
                "{environments} environments; the critic has states of {}",
                found / self.width
            ))),
        }
    }

    /// Keeps the states in which a rollout ended. States that are not finite become zeros: they would never recover.
    pub(super) fn carry(&mut self, unrolled: &Unrolled) {
        self.carried.clone_from(&unrolled.last);
        for state in self.carried.chunks_exact_mut(self.width) {
            if !state.iter().all(|x| x.is_finite()) {
                state.fill(0.0);
            }
        }
    }

    /// Replaces the carried state of an environment by zeros.
    pub(super) fn forget(&mut self, environment: usize) {
        let state = self.carried.chunks_exact_mut(self.width).nth(environment);
        state.into_iter().for_each(|state| state.fill(0.0));
    }

    /// Visits the carried states, `[B, H]`; `[0, H]` before the first rollout.
    pub(super) fn visit(&mut self, name: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        visitor.array(name, ArrayShape::Rows(&[self.width]), Elements::F32(&mut self.carried))
    }
}

impl Unrolled {
    /// From the states after every row, `[T * B, H]`, and those before the rollout, `start`, `[B, H]`.
    fn new(batch: &Batch, layout: ChunkLayout, states: &[f32], start: &[f32]) -> Self {
        let count = batch.environments;
        let rows = batch.rows();
        assert_shape("states", states.len() * count, start.len() * rows);
        let width = start.len() / count;
        let after = |row: usize| {
            if batch.done(row) {
                vec![0.0; width]
            } else {
                states[row * width..(row + 1) * width].to_vec()
            }
        };
        let mut starts = start.to_vec();
        for chunk in count..layout.chunks {
            starts.extend(after(layout.source(0, chunk) - count));
        }
        let last = (rows - count..rows).flat_map(after).collect();
        Self { width, starts, mask: mask(batch, layout), last }
    }

    /// Start of the chunks `columns`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(super) fn start(
        &self,
        layout: ChunkLayout,
        columns: &[usize],
    ) -> Result<SequenceStart, MarlError> {
        let width = self.width;
        let state = |&column: &usize| &self.starts[column * width..(column + 1) * width];
        let states = columns.iter().flat_map(state).copied().collect();
        let mask = layout.columns(&self.mask, 1, columns);
        SequenceStart::new(states, mask, (columns.len(), width))
    }
}

impl SequenceStart {
    /// From states `[P, H]` and a mask `[L, P]` of `(P, H)`.
    fn new(
        states: Vec<f32>,
        mask: Vec<f32>,
        (count, width): (usize, usize),
    ) -> Result<Self, MarlError> {
        assert_shape("start states", states.len(), count * width);
        let mask_shape = (mask.len() / count, count);
        let states = Tensor::from_vec(states, (count, width), &Device::Cpu)?;
        Ok(Self { states, mask: Tensor::from_vec(mask, mask_shape, &Device::Cpu)? })
    }

    pub(super) fn input(&self) -> RecurrentInput<'_> {
        RecurrentInput { start: &self.states, mask: &self.mask }
    }
}

/// Sequences of equal length: `L` steps of `C` sequences, rows `l * C + c`.
struct Run<'a> {
    layout: ChunkLayout,
    /// The critic's input before scaling, `[L, C, S]`.
    rows: &'a [f32],
    /// Before the first step, `[C, H]`.
    start: &'a [f32],
    /// 0 where the state is reset before the step, else 1, `[L, C]`.
    mask: &'a [f32],
}

impl Critic {
    /// Normalised values of every row, `[T * B, V]`, and of the states `finals` `[F, S]`, `[F, V]`, each final with the
    /// recurrent state of its step; and the recurrent states from which the fit starts.
    ///
    /// # Errors
    /// If `memory` is that of another number of environments, or a tensor operation fails.
    pub(super) fn unroll(
        &self,
        memory: &Memory,
        batch: &Batch,
        finals: &[f32],
    ) -> Result<(Vec<f64>, Vec<f64>, Unrolled), MarlError> {
        let weights = self.layers.constant_weights()?;
        let start = memory.start(batch.environments)?;
        let width = memory.width;
        let layout = ChunkLayout::of(batch, batch.steps);
        let mask = mask(batch, layout);
        let whole = Run { layout, rows: &batch.state, start: &start, mask: &mask };
        let (normalized, states) = self.run(&weights, &whole, width)?;
        let of_final = |row: usize| &states[row * width..(row + 1) * width];
        let ends =
            batch.finals.iter().map(|last| last.step * batch.environments + last.environment);
        let before: Vec<f32> = ends.flat_map(of_final).copied().collect();
        let count = batch.finals.len();
        let layout = ChunkLayout { steps: 1, chunks: count, environments: count };
        let mask = vec![1.0; count];
        let once = Run { layout, rows: finals, start: &before, mask: &mask };
        let (finals, _) = self.run(&weights, &once, width)?;
        Ok((normalized, finals, Unrolled::new(batch, memory.layout(batch), &states, &start)))
    }

    /// Normalised values `[L, C, V]` of sequences and the states after every row, `[L, C, H]`, `H = width`.
    fn run(
        &self,
        weights: &Weights,
        run: &Run<'_>,
        width: usize,
    ) -> Result<(Vec<f64>, Vec<f32>), MarlError> {
        let Run { layout, rows: input, start, mask } = *run;
        assert_shape("states", input.len(), layout.rows() * self.inputs);
        assert_shape("start states", start.len(), layout.chunks * width);
        assert_shape("mask", mask.len(), layout.rows());
        let one = |range: Range<usize>| {
            let columns: Vec<usize> = range.clone().collect();
            let mut own = layout.columns(input, self.inputs, &columns);
            self.scale.apply(&mut own, self.inputs);
            let states = start[range.start * width..range.end * width].to_vec();
            let mask = layout.columns(mask, 1, &columns);
            let start = SequenceStart::new(states, mask, (columns.len(), width))?;
            let own = rows(own, self.inputs)?;
            let (states, values) = weights.states_and_output(&own, start.input())?;
            let states = states.flatten_all()?.to_vec1::<f32>()?;
            Ok((columns, numbers(&values)?, states))
        };
        let mut values = vec![0.0; layout.rows() * self.count];
        let mut states = vec![0.0; layout.rows() * width];
        for (columns, own, after) in shards::of_each(&shards(layout.chunks, layout.steps), one)? {
            layout.scatter(&own, &mut values, self.count, &columns);
            layout.scatter(&after, &mut states, width, &columns);
        }
        Ok((values, states))
    }
}

#[cfg(test)]
mod tests;
