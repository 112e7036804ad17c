//! Rows of values, padded to whole cache lines.

use crate::simd::{LANES, Line};

/// The values of `lines`, padding included.
pub(crate) fn numbers(lines: &[Line]) -> &[f32] {
    // SAFETY: a line is sixteen floats without padding, and aligned more strictly than they are.
    unsafe { core::slice::from_raw_parts(lines.as_ptr().cast(), lines.len() * LANES) }
}

/// Lines needed for `width` values.
pub(crate) fn groups(width: usize) -> usize {
    width.div_ceil(LANES)
}

/// Lines from one row of `width` values to the next. Odd, so that the rows of a block map to different cache sets.
pub(crate) fn stride(width: usize) -> usize {
    groups(width) | 1
}

/// Rows of `width` values. Each row starts a new line and is padded with 0.
#[derive(Clone, Debug, Default)]
pub(crate) struct PaddedRows {
    lines: Vec<Line>,
    width: usize,
}

impl PaddedRows {
    /// Resizes to `rows` rows of `width` values. The contents are then unspecified.
    pub(crate) fn resize(&mut self, rows: usize, width: usize) {
        self.width = width;
        self.lines.resize(rows * stride(width), Line::default());
    }

    pub(crate) fn width(&self) -> usize {
        self.width
    }

    pub(crate) fn stride(&self) -> usize {
        stride(self.width)
    }

    /// The lines of the rows `from..to`.
    pub(crate) fn range(&self, from: usize, to: usize) -> &[Line] {
        &self.lines[from * self.stride()..to * self.stride()]
    }

    /// The lines of the rows `from..to`.
    pub(crate) fn range_mut(&mut self, from: usize, to: usize) -> &mut [Line] {
        let stride = self.stride();
        &mut self.lines[from * stride..to * stride]
    }

    /// Copies dense rows `[rows, width]` to the rows from `first` on.
    pub(crate) fn fill(&mut self, first: usize, dense: &[f32]) {
        let width = self.width;
        let stride = self.stride();
        let lines = self.lines[first * stride..].chunks_exact_mut(stride);
        for (lines, row) in lines.zip(dense.chunks_exact(width)) {
            for (line, part) in lines.iter_mut().zip(row.chunks(LANES)) {
                line.0[..part.len()].copy_from_slice(part);
                line.0[part.len()..].fill(0.0);
            }
        }
    }

    /// Appends the rows `from..to` to `dense`.
    pub(crate) fn append_to(&self, from: usize, to: usize, dense: &mut Vec<f32>) {
        let lines = self.range(from, to).chunks_exact(self.stride());
        lines.for_each(|row| dense.extend_from_slice(&numbers(row)[..self.width]));
    }
}

/// `values` as lines, padded with 0.
pub(crate) fn padded(values: &[f32]) -> Vec<Line> {
    let mut lines = vec![Line::default(); groups(values.len())];
    for (line, part) in lines.iter_mut().zip(values.chunks(LANES)) {
        line.0[..part.len()].copy_from_slice(part);
    }
    lines
}

/// Copies `lines` to `values`, without the padding.
pub(crate) fn unpadded(lines: &[Line], values: &mut [f32]) {
    for (line, part) in lines.iter().zip(values.chunks_mut(LANES)) {
        part.copy_from_slice(&line.0[..part.len()]);
    }
}
