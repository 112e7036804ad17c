//! Buffers of a forward and backward pass, reused between steps to avoid allocation.

use crate::buffer::PaddedRows;
use crate::gru::Trace;
use crate::norm::RowMoments;
use crate::simd::Line;

/// Buffers of one forward pass and its backward pass.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    pub(crate) rows: usize,
    /// The input and every layer's result.
    pub(crate) activations: Vec<PaddedRows>,
    /// Statistics of every layer norm's rows.
    pub(crate) moments: Vec<Vec<RowMoments>>,
    pub(crate) trace: Trace,
    /// Gradient of a segment's result and of its input, all rows.
    pub(crate) gradients: [PaddedRows; 2],
    /// The same for one layer and one block of rows.
    pub(crate) blocks: [Vec<Line>; 2],
}

impl Workspace {
    /// Appends the output of all rows to `into`, `[rows, outputs]`.
    pub fn append_output(&self, into: &mut Vec<f32>) {
        self.append_result(self.activations.len().saturating_sub(1), into);
    }

    /// Appends the input of the last layer to `into`, `[rows, F]`.
    pub fn append_features(&self, into: &mut Vec<f32>) {
        self.append_result(self.activations.len().saturating_sub(2), into);
    }

    /// Appends to `into` the states of the GRU with index `layer` after every row, `[rows, H]`.
    pub fn append_states(&self, layer: usize, into: &mut Vec<f32>) {
        self.append_result(layer + 1, into);
    }

    /// Appends to `into` the states of the GRU with index `layer` after the last step of `sequences` sequences, `[B, H]`.
    pub fn append_last_states(&self, layer: usize, sequences: usize, into: &mut Vec<f32>) {
        self.activations[layer + 1].append_to(self.rows - sequences, self.rows, into);
    }

    fn append_result(&self, index: usize, into: &mut Vec<f32>) {
        if let Some(result) = self.activations.get(index) {
            result.append_to(0, self.rows, into);
        }
    }
}
