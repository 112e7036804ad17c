//! Layer normalisation for a block of rows.

use crate::LAYER_NORM_EPSILON;
use crate::buffer::{groups, padded, stride, unpadded};
use crate::simd::{LANES, Line, Simd};

/// Statistics of a row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RowMoments {
    mean: f32,
    /// `1 / sqrt(var + epsilon)`.
    inverse_deviation: f32,
}

impl RowMoments {
    #[inline(always)]
    fn splat<S: Simd>(self, simd: S) -> (S::Vector, S::Vector) {
        (simd.splat(self.mean), simd.splat(self.inverse_deviation))
    }
}

/// Weight and bias, padded.
#[derive(Clone, Debug)]
pub(crate) struct Norm {
    width: usize,
    weight: Vec<Line>,
    bias: Vec<Line>,
    /// 1 in the lanes of the last group that hold values, 0 in its padding.
    mask: Line,
}

impl Norm {
    /// From the concatenation of `weight` and `bias`, `[width]` each.
    pub(crate) fn new(parameters: &[f32]) -> Self {
        let width = parameters.len() / 2;
        let (weight, bias) = parameters.split_at(width);
        let mut mask = Line([1.0; LANES]);
        let used = width - (groups(width) - 1) * LANES;
        mask.0[used..].fill(0.0);
        Self { width, weight: padded(weight), bias: padded(bias), mask }
    }

    /// `x - mean`; 0 in the padding.
    #[inline(always)]
    fn centred<S: Simd>(&self, simd: S, x: &Line, group: usize, mean: S::Vector) -> S::Vector {
        let centred = simd.sub(simd.load(x), mean);
        if group + 1 == self.weight.len() {
            simd.mul(centred, simd.load(&self.mask))
        } else {
            centred
        }
    }

    #[inline(always)]
    fn moments<S: Simd>(&self, simd: S, x: &[Line]) -> RowMoments {
        let count = self.width as f32;
        let mut sums = simd.splat(0.0);
        for line in x {
            sums = simd.add(sums, simd.load(line));
        }
        let mean = simd.sum(sums) / count;
        let (mut squares, middle) = (simd.splat(0.0), simd.splat(mean));
        for (group, line) in x.iter().enumerate() {
            let centred = self.centred(simd, line, group, middle);
            squares = simd.fma(centred, centred, squares);
        }
        let variance = simd.sum(squares) / count;
        RowMoments { mean, inverse_deviation: 1.0 / (variance + LAYER_NORM_EPSILON).sqrt() }
    }

    #[inline(always)]
    pub(crate) fn forward<S: Simd>(
        &self,
        simd: S,
        x: &[Line],
        y: &mut [Line],
        moments: &mut [RowMoments],
    ) {
        let (stride, groups) = (stride(self.width), groups(self.width));
        let rows = x.chunks_exact(stride).zip(y.chunks_exact_mut(stride));
        for ((x, y), moments) in rows.zip(moments) {
            let x = &x[..groups];
            let y = &mut y[..groups];
            *moments = self.moments(simd, x);
            let (mean, inverse) = moments.splat(simd);
            for (group, (x, y)) in x.iter().zip(y).enumerate() {
                let normal = simd.mul(simd.sub(simd.load(x), mean), inverse);
                let (weight, bias) = (&self.weight[group], &self.bias[group]);
                simd.store(simd.fma(normal, simd.load(weight), simd.load(bias)), y);
            }
        }
    }

    /// Adds to the gradient of weight and bias, and writes the gradient of `x`.
    #[inline(always)]
    pub(crate) fn backward<S: Simd>(
        &self,
        simd: S,
        x: &[Line],
        g: &[Line],
        moments: &[RowMoments],
        parameters: Option<&mut [f32]>,
        dx: Option<&mut [Line]>,
    ) {
        if let Some(parameters) = parameters {
            self.add_gradient(simd, x, g, moments, parameters);
        }
        let Some(dx) = dx else { return };
        let (stride, groups) = (stride(self.width), groups(self.width));
        let rows = x.chunks_exact(stride).zip(g.chunks_exact(stride)).zip(moments);
        for (((x, g), &moments), dx) in rows.zip(dx.chunks_exact_mut(stride)) {
            self.backward_row(simd, &x[..groups], &g[..groups], moments, &mut dx[..groups]);
        }
    }

    /// `dx = (d - (sum d + normal sum d normal) / n) / deviation` with `d = g weight`.
    #[inline(always)]
    fn backward_row<S: Simd>(
        &self,
        simd: S,
        x: &[Line],
        g: &[Line],
        moments: RowMoments,
        dx: &mut [Line],
    ) {
        let (mean, inverse) = moments.splat(simd);
        let (mut plain, mut normals) = (simd.splat(0.0), simd.splat(0.0));
        for (group, (x, g)) in x.iter().zip(g).enumerate() {
            let d = simd.mul(simd.load(g), simd.load(&self.weight[group]));
            let normal = simd.mul(simd.sub(simd.load(x), mean), inverse);
            plain = simd.add(plain, d);
            normals = simd.fma(d, normal, normals);
        }
        let share = 1.0 / self.width as f32;
        let plain = simd.splat(simd.sum(plain) * share);
        let normals = simd.splat(simd.sum(normals) * share);
        for (group, ((x, g), dx)) in x.iter().zip(g).zip(dx).enumerate() {
            let d = simd.mul(simd.load(g), simd.load(&self.weight[group]));
            let normal = simd.mul(simd.sub(simd.load(x), mean), inverse);
            let rest = simd.sub(d, simd.fma(normal, normals, plain));
            let mut found = simd.mul(rest, inverse);
            if group + 1 == self.weight.len() {
                found = simd.mul(found, simd.load(&self.mask));
            }
            simd.store(found, dx);
        }
    }

    #[inline(always)]
    fn add_gradient<S: Simd>(
        &self,
        simd: S,
        x: &[Line],
        g: &[Line],
        moments: &[RowMoments],
        parameters: &mut [f32],
    ) {
        let stride = stride(self.width);
        let (weight, bias) = parameters.split_at_mut(self.width);
        let (mut by_weight, mut by_bias) = (padded(weight), padded(bias));
        let rows = x.chunks_exact(stride).zip(g.chunks_exact(stride)).zip(moments);
        for ((x, g), moments) in rows {
            let (mean, inverse) = moments.splat(simd);
            let sums = by_weight.iter_mut().zip(&mut by_bias);
            for ((by_weight, by_bias), (x, g)) in sums.zip(x.iter().zip(g)) {
                let normal = simd.mul(simd.sub(simd.load(x), mean), inverse);
                let g = simd.load(g);
                simd.store(simd.fma(g, normal, simd.load(by_weight)), by_weight);
                simd.store(simd.add(simd.load(by_bias), g), by_bias);
            }
        }
        unpadded(&by_weight, weight);
        unpadded(&by_bias, bias);
    }
}
