//! `D_k` cut into chunks, the sequences on which a recurrent policy is trained.
//!
//! Chunk `c = k * B + b` contains steps `k * L .. (k + 1) * L` of environment `b`. Chunked rows are time-major: row
//! `l * C + c`. An update uses this order only.

use std::ops::Range;

use candle_core::{Device, Tensor};
use policy::network::SequenceInput;

use crate::data::batch::Batch;
use crate::error::MarlError;

/// Mapping of `T x B` rows to `L x C` chunked rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkLayout {
    /// `L`, steps per chunk.
    pub steps: usize,
    /// `C`, chunks.
    pub chunks: usize,
    /// `B`, environments.
    pub environments: usize,
}

impl ChunkLayout {
    /// Layout of `batch` in chunks of `chunk_steps` steps, a divisor of the batch's steps.
    #[must_use]
    pub fn of(batch: &Batch, chunk_steps: usize) -> Self {
        let chunks = batch.steps / chunk_steps * batch.environments;
        Self { steps: chunk_steps, chunks, environments: batch.environments }
    }

    /// Number of rows, `L * C = T * B`.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.steps * self.chunks
    }

    /// Environment of a chunk.
    #[must_use]
    pub fn environment(&self, chunk: usize) -> usize {
        chunk % self.environments
    }

    /// Time-major row `t * B + b` of step `step` of chunk `chunk`.
    #[must_use]
    pub fn source(&self, step: usize, chunk: usize) -> usize {
        let k = chunk / self.environments;
        let environment = chunk % self.environments;
        (k * self.steps + step) * self.environments + environment
    }

    /// Time-major rows of the chunks `columns`, `[L, columns]`.
    #[must_use]
    pub fn sources(&self, columns: &[usize]) -> Vec<usize> {
        let step = |step: usize| columns.iter().map(move |&column| self.source(step, column));
        (0..self.steps).flat_map(step).collect()
    }

    /// Converts `[T, B, width]` data to chunked order, `[L, C, width]`.
    pub(crate) fn chunked<V: Copy>(&self, data: &[V], width: usize) -> Vec<V> {
        let mut out = Vec::with_capacity(data.len());
        for step in 0..self.steps {
            for chunk in 0..self.chunks {
                let row = self.source(step, chunk);
                out.extend_from_slice(&data[row * width..(row + 1) * width]);
            }
        }
        out
    }

    /// Rows of the chunks `columns` in chunked data `[L, C, width]`, `[L, columns, width]`.
    #[must_use]
    pub fn columns<V: Copy>(&self, data: &[V], width: usize, columns: &[usize]) -> Vec<V> {
        let mut out = Vec::with_capacity(self.steps * columns.len() * width);
        for step in 0..self.steps {
            for &column in columns {
                let row = step * self.chunks + column;
                out.extend_from_slice(&data[row * width..(row + 1) * width]);
            }
        }
        out
    }

    /// For every row of chunked data, its index in the concatenation of `parts`, each `[L, chunks]`.
    #[must_use]
    pub fn order(&self, parts: &[Range<usize>]) -> Vec<u32> {
        let mut order = vec![0; self.rows()];
        for chunks in parts {
            for step in 0..self.steps {
                for chunk in chunks.clone() {
                    let within = step * chunks.len() + chunk - chunks.start;
                    let place = chunks.start * self.steps + within;
                    order[step * self.chunks + chunk] = place as u32;
                }
            }
        }
        order
    }

    /// Writes `[L, columns, width]` data to its rows in chunked data `[L, C, width]`.
    pub fn scatter<V: Copy>(&self, from: &[V], to: &mut [V], width: usize, columns: &[usize]) {
        for step in 0..self.steps {
            for (place, &column) in columns.iter().enumerate() {
                let source = (step * columns.len() + place) * width;
                let target = (step * self.chunks + column) * width;
                to[target..target + width].copy_from_slice(&from[source..source + width]);
            }
        }
    }
}

/// One agent's rollout data in chunked order.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sequences {
    /// Mapping of rows to chunks.
    pub layout: ChunkLayout,
    /// Observations, `[L, C, obs]`.
    pub observation: Vec<f32>,
    /// Actions taken, `[L, C, act]`.
    pub action: Vec<f64>,
    /// Recurrent state at each chunk's start, `[C, H]`.
    pub hidden: Vec<f32>,
    /// 0 where an episode has just begun, so that the recurrent state is reset, `[L, C]`. A chunk's first step has 1:
    /// its stored state is already reset.
    pub mask: Vec<f32>,
    /// Signal that all agents share, `[L, C, K]`; empty with independent noise.
    pub signal: Vec<f64>,
    widths: (usize, usize),
}

impl Sequences {
    /// Chunks of agent `agent` of `batch`; `hidden` is the size `H` of its recurrent state.
    pub(crate) fn of(batch: &Batch, agent: usize, layout: ChunkLayout, hidden: usize) -> Self {
        let data = &batch.agents[agent];
        let observation = data.observation.len() / batch.rows();
        let action: Vec<f64> = data.action.iter().map(|&a| f64::from(a)).collect();
        let width = action.len() / batch.rows();
        Self {
            layout,
            observation: layout.chunked(&data.observation, observation),
            action: layout.chunked(&action, width),
            hidden: data.hidden.clone(),
            mask: mask(batch, layout),
            signal: Vec::new(),
            widths: (observation, hidden),
        }
    }

    /// Network input for the chunks `columns`, from their stored states.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn input(&self, columns: &[usize]) -> Result<SequenceInput, MarlError> {
        let steps = self.layout.steps;
        let count = columns.len();
        let (observation, hidden) = self.widths;
        let state = |&column: &usize| &self.hidden[column * hidden..(column + 1) * hidden];
        let start = columns.iter().flat_map(state).copied().collect();
        let tensor =
            |data: Vec<f32>, shape: (usize, usize)| Tensor::from_vec(data, shape, &Device::Cpu);
        Ok(SequenceInput {
            observation: tensor(
                self.layout.columns(&self.observation, observation, columns),
                (steps * count, observation),
            )?,
            hidden: tensor(start, (count, hidden))?,
            mask: tensor(self.layout.columns(&self.mask, 1, columns), (steps, count))?,
        })
    }
}

/// As [`Sequences::mask`].
pub(crate) fn mask(batch: &Batch, layout: ChunkLayout) -> Vec<f32> {
    let mut mask = vec![1.0; layout.rows()];
    for step in 1..layout.steps {
        for chunk in 0..layout.chunks {
            if batch.done(layout.source(step - 1, chunk)) {
                mask[step * layout.chunks + chunk] = 0.0;
            }
        }
    }
    mask
}
