//! What a forward pass leaves to the backward pass, kept from step to step so that nothing is allocated again.

use crate::buffer::Rows;
use crate::gru::Trace;
use crate::norm::Moments;
use crate::simd::Line;

/// Buffers of one pass at a time.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    pub(crate) rows: usize,
    /// The input and every layer's result.
    pub(crate) activations: Vec<Rows>,
    /// Of every layer norm's rows.
    pub(crate) moments: Vec<Vec<Moments>>,
    pub(crate) trace: Trace,
    /// Gradient by a result of all rows, where a pass through blocks ends.
    pub(crate) gradients: [Rows; 2],
    /// Gradient by a block's results.
    pub(crate) blocks: [Vec<Line>; 2],
}

impl Workspace {
    /// Appends the output of all rows to `into`, `[rows, outputs]`.
    pub fn append_output(&self, into: &mut Vec<f32>) {
        self.append_result(self.activations.len().saturating_sub(1), into);
    }

    /// Appends to `into` what the last layer was given, `[rows, F]`.
    pub fn append_features(&self, into: &mut Vec<f32>) {
        self.append_result(self.activations.len().saturating_sub(2), into);
    }

    /// Appends to `into` the states after the last step of `sequences` sequences, `[B, H]`, of a GRU that is layer
    /// `layer`.
    pub fn append_last_states(&self, layer: usize, sequences: usize, into: &mut Vec<f32>) {
        self.activations[layer + 1].append_to(self.rows - sequences, self.rows, into);
    }

    fn append_result(&self, index: usize, into: &mut Vec<f32>) {
        if let Some(result) = self.activations.get(index) {
            result.append_to(0, self.rows, into);
        }
    }
}
