//! A policy's layers on a few rows, compiled once for each width of registers that a processor may have.
//!
//! Everything here is inlined into [`Network::with_simd`]: only there does the compiler know how wide they are. Hence
//! loops and no closures, which would be compiled by themselves. A multiplication and an addition are never one operation,
//! so that every width gives the same bits.

use core::ops::Range;

use pulp::{Simd, WithSimd};

use crate::math::{sigmoids, tanhs};
use crate::ops::LAYER_NORM_EPSILON;

/// Registers of outputs whose sums grow side by side.
const BLOCK: usize = 4;

/// The most lanes that a register has.
const LANES: usize = 16;

/// Rows that share the weights that were read.
const GROUP: usize = 2;

/// One forward pass over `R` rows.
pub(super) struct Network<'a> {
    pub(super) trunk: &'a Trunk,
    pub(super) head: &'a Dense,
    /// `[R, obs]`
    pub(super) observation: &'a [f32],
    /// `[R, H]`, moves on by a step.
    pub(super) hidden: &'a mut [f32],
    /// `[R, out]`, written.
    pub(super) output: &'a mut [f32],
    pub(super) buffers: &'a mut Buffers,
}

impl WithSimd for Network<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.trunk.features(simd, self.observation, self.hidden, self.buffers);
        self.head.apply(simd, &self.buffers.normal, self.output);
    }
}

/// What layers leave for the next one, rows one after another.
#[derive(Clone, Debug, Default)]
pub(super) struct Buffers {
    normal: Vec<f32>,
    layer: Vec<f32>,
    input: Vec<f32>,
    recurrent: Vec<f32>,
}

/// The layers from observations to features.
#[derive(Clone, Debug)]
pub(super) enum Trunk {
    Gru { norm: Norm, encoder: Dense, input: Dense, recurrent: Dense, output: Norm },
    Mlp { norm: Norm, layers: Vec<(Dense, Norm)> },
}

impl Trunk {
    /// Features of all rows, left in `buffers.normal`.
    #[inline(always)]
    fn features<S: Simd>(
        &self,
        simd: S,
        observation: &[f32],
        state: &mut [f32],
        buffers: &mut Buffers,
    ) {
        match self {
            Self::Gru { norm, encoder, input, recurrent, output } => {
                norm.apply(simd, observation, &mut buffers.normal);
                encoder.apply_resized(simd, &buffers.normal, &mut buffers.layer);
                squash(simd, &mut buffers.layer);
                input.apply_resized(simd, &buffers.layer, &mut buffers.input);
                recurrent.apply_resized(simd, state, &mut buffers.recurrent);
                let width = output.weight.len();
                let gates = buffers.input.chunks_exact(3 * width);
                let gates = gates.zip(buffers.recurrent.chunks_exact(3 * width));
                for ((input, recurrent), state) in gates.zip(state.chunks_exact_mut(width)) {
                    cell(simd, input, recurrent, state);
                }
                output.apply(simd, state, &mut buffers.normal);
            }
            Self::Mlp { norm, layers } => {
                norm.apply(simd, observation, &mut buffers.normal);
                for (dense, norm) in layers {
                    dense.apply_resized(simd, &buffers.normal, &mut buffers.layer);
                    for x in &mut buffers.layer {
                        *x = x.max(0.0);
                    }
                    norm.apply(simd, &buffers.layer, &mut buffers.normal);
                }
            }
        }
    }
}

/// Every number's hyperbolic tangent.
#[inline(always)]
fn squash<S: Simd>(simd: S, x: &mut [f32]) {
    let (wide, rest) = S::as_mut_simd_f32s(x);
    for x in wide {
        *x = tanhs(simd, *x);
    }
    let tangents = tanhs(simd, simd.partial_load_f32s(rest));
    simd.partial_store_f32s(rest, tangents);
}

/// Weights `[in, out]`, so that the inner loop runs over outputs.
#[derive(Clone, Debug)]
pub(super) struct Dense {
    outputs: usize,
    /// `[in, stride]`, zeros beyond the outputs.
    weight: Vec<f32>,
    /// `[stride]`
    bias: Vec<f32>,
}

impl Dense {
    /// From PyTorch's `weight`, `[out, in]`, and `bias`, `[out]`.
    pub(super) fn new(weight: &[f32], bias: &[f32]) -> Self {
        let (inputs, outputs) = (weight.len() / bias.len(), bias.len());
        let stride = outputs.next_multiple_of(LANES);
        let mut turned = vec![0.0; inputs * stride];
        for (output, row) in weight.chunks_exact(inputs).enumerate() {
            for (input, &weight) in row.iter().enumerate() {
                turned[input * stride + output] = weight;
            }
        }
        let mut padded = bias.to_vec();
        padded.resize(stride, 0.0);
        Self { outputs, weight: turned, bias: padded }
    }

    #[inline(always)]
    fn inputs(&self) -> usize {
        self.weight.len() / self.bias.len()
    }

    #[inline(always)]
    fn apply_resized<S: Simd>(&self, simd: S, x: &[f32], y: &mut Vec<f32>) {
        y.resize(x.len() / self.inputs() * self.outputs, 0.0);
        self.apply(simd, x, y);
    }

    /// `y = x weight + bias` for rows `x`, `[R, in]`, and `y`, `[R, out]`.
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: &[f32], y: &mut [f32]) {
        let whole = y.len() / self.outputs / GROUP * GROUP;
        let (x, last_x) = x.split_at(whole * self.inputs());
        let (y, last_y) = y.split_at_mut(whole * self.outputs);
        let groups = x.chunks_exact(GROUP * self.inputs());
        for (x, y) in groups.zip(y.chunks_exact_mut(GROUP * self.outputs)) {
            self.group::<S, GROUP>(simd, x, y);
        }
        for (x, y) in last_x.chunks_exact(self.inputs()).zip(last_y.chunks_exact_mut(self.outputs))
        {
            self.group::<S, 1>(simd, x, y);
        }
    }

    /// Each output takes its terms in the order of the inputs, whatever block or group it stands in.
    #[inline(always)]
    fn group<S: Simd, const ROWS: usize>(&self, simd: S, x: &[f32], y: &mut [f32]) {
        let mut first = 0;
        while first < self.outputs {
            if first + BLOCK * S::F32_LANES <= self.bias.len() {
                self.block::<S, ROWS, BLOCK>(simd, x, y, first);
                first += BLOCK * S::F32_LANES;
            } else {
                self.block::<S, ROWS, 1>(simd, x, y, first);
                first += S::F32_LANES;
            }
        }
    }

    /// `REGISTERS` registers of outputs, the first of which is `first`.
    #[inline(always)]
    fn block<S: Simd, const ROWS: usize, const REGISTERS: usize>(
        &self,
        simd: S,
        x: &[f32],
        y: &mut [f32],
        first: usize,
    ) {
        let width = REGISTERS * S::F32_LANES;
        let (bias, _) = S::as_simd_f32s(&self.bias[first..][..width]);
        let mut sums = [[simd.splat_f32s(0.0); REGISTERS]; ROWS];
        for sums in &mut sums {
            sums.copy_from_slice(bias);
        }
        let x = &x[..ROWS * self.inputs()];
        for (input, weights) in self.weight.chunks_exact(self.bias.len()).enumerate() {
            let (weights, _) = S::as_simd_f32s(&weights[first..][..width]);
            for row in 0..ROWS {
                let x = simd.splat_f32s(x[row * self.inputs() + input]);
                for register in 0..REGISTERS {
                    let term = simd.mul_f32s(x, weights[register]);
                    sums[row][register] = simd.add_f32s(sums[row][register], term);
                }
            }
        }
        for (y, sums) in y.chunks_exact_mut(self.outputs).zip(sums) {
            for (y, sum) in y[first..].chunks_mut(S::F32_LANES).zip(sums) {
                simd.partial_store_f32s(y, sum);
            }
        }
    }
}

/// Layer normalisation.
#[derive(Clone, Debug)]
pub(super) struct Norm {
    pub(super) weight: Vec<f32>,
    pub(super) bias: Vec<f32>,
}

impl Norm {
    /// `y = (x - mean) / deviation * weight + bias` for every row of `x`, `[R, W]`.
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: &[f32], y: &mut Vec<f32>) {
        y.resize(x.len(), 0.0);
        let (x, y) = self.groups::<S, 8>(simd, x, y);
        let (x, y) = self.groups::<S, GROUP>(simd, x, y);
        self.groups::<S, 1>(simd, x, y);
    }

    /// As many whole groups of rows as there are; gives back the rest.
    #[inline(always)]
    fn groups<'a, S: Simd, const ROWS: usize>(
        &self,
        simd: S,
        x: &'a [f32],
        y: &'a mut [f32],
    ) -> (&'a [f32], &'a mut [f32]) {
        let group = ROWS * self.weight.len();
        let whole = x.len() / group * group;
        let (x, rest_x) = x.split_at(whole);
        let (y, rest_y) = y.split_at_mut(whole);
        for (x, y) in x.chunks_exact(group).zip(y.chunks_exact_mut(group)) {
            self.group::<S, ROWS>(simd, x, y);
        }
        (rest_x, rest_y)
    }

    /// A row's sums go from its first number to its last; those of a group grow side by side.
    #[inline(always)]
    fn group<S: Simd, const ROWS: usize>(&self, simd: S, x: &[f32], y: &mut [f32]) {
        let width = self.weight.len();
        let count = width as f32;
        let mut mean = [-0.0; ROWS];
        for i in 0..width {
            for row in 0..ROWS {
                mean[row] += x[row * width + i];
            }
        }
        for mean in &mut mean {
            *mean /= count;
        }
        let mut squares = [-0.0; ROWS];
        for i in 0..width {
            for row in 0..ROWS {
                let distance = x[row * width + i] - mean[row];
                squares[row] += distance * distance;
            }
        }
        let rows = x.chunks_exact(width).zip(y.chunks_exact_mut(width));
        for ((x, y), (mean, squares)) in rows.zip(mean.iter().zip(&squares)) {
            let inverse = 1.0 / (squares / count + LAYER_NORM_EPSILON as f32).sqrt();
            self.scale(simd, x, y, simd.splat_f32s(*mean), simd.splat_f32s(inverse));
        }
    }

    /// `y = (x - mean) inverse weight + bias` of one row.
    #[inline(always)]
    fn scale<S: Simd>(&self, simd: S, x: &[f32], y: &mut [f32], mean: S::f32s, inverse: S::f32s) {
        let numbers = x.chunks(S::F32_LANES).zip(y.chunks_mut(S::F32_LANES));
        let affine = self.weight.chunks(S::F32_LANES).zip(self.bias.chunks(S::F32_LANES));
        for ((x, y), (weight, bias)) in numbers.zip(affine) {
            let normal = simd.mul_f32s(simd.sub_f32s(simd.partial_load_f32s(x), mean), inverse);
            let scaled = simd.mul_f32s(normal, simd.partial_load_f32s(weight));
            simd.partial_store_f32s(y, simd.add_f32s(scaled, simd.partial_load_f32s(bias)));
        }
    }
}

/// The gated unit on one row, gates r, z, n; see `ops::gru_sequence`.
#[inline(always)]
fn cell<S: Simd>(simd: S, input: &[f32], recurrent: &[f32], state: &mut [f32]) {
    let width = state.len();
    let one = simd.splat_f32s(1.0);
    for (index, state) in state.chunks_mut(S::F32_LANES).enumerate() {
        let first = index * S::F32_LANES;
        let end = first + state.len();
        let [input_r, input_z, input_n] = gates(simd, input, width, first..end);
        let [recurrent_r, recurrent_z, recurrent_n] = gates(simd, recurrent, width, first..end);
        let r = sigmoids(simd, simd.add_f32s(input_r, recurrent_r));
        let z = sigmoids(simd, simd.add_f32s(input_z, recurrent_z));
        let n = tanhs(simd, simd.add_f32s(input_n, simd.mul_f32s(r, recurrent_n)));
        let new = simd.mul_f32s(simd.sub_f32s(one, z), n);
        let kept = simd.mul_f32s(z, simd.partial_load_f32s(state));
        simd.partial_store_f32s(state, simd.add_f32s(new, kept));
    }
}

/// The units `range` of each of a row's three gates.
#[inline(always)]
fn gates<S: Simd>(simd: S, row: &[f32], width: usize, range: Range<usize>) -> [S::f32s; 3] {
    [
        simd.partial_load_f32s(&row[range.clone()]),
        simd.partial_load_f32s(&row[width..][range.clone()]),
        simd.partial_load_f32s(&row[2 * width..][range]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 37 % 101) as f32 - 50.0) / 40.0).collect()
    }

    /// A recurrent network whose sizes fill no register, on five rows: outputs and states.
    fn acted(on: impl FnOnce(Network<'_>)) -> (Vec<f32>, Vec<f32>) {
        let (observation, encoder, hidden, output, rows) = (23, 37, 21, 3, 5);
        let dense = |from, to| Dense::new(&numbers(from * to), &numbers(to));
        let norm = |width| Norm { weight: numbers(width), bias: numbers(width) };
        let trunk = Trunk::Gru {
            norm: norm(observation),
            encoder: dense(observation, encoder),
            input: dense(encoder, 3 * hidden),
            recurrent: dense(hidden, 3 * hidden),
            output: norm(hidden),
        };
        let (mut states, mut outputs) = (numbers(rows * hidden), vec![0.0; rows * output]);
        on(Network {
            trunk: &trunk,
            head: &dense(hidden, output),
            observation: &numbers(rows * observation),
            hidden: &mut states,
            output: &mut outputs,
            buffers: &mut Buffers::default(),
        });
        (outputs, states)
    }

    #[test]
    fn registers_of_every_width_give_the_same_bits() {
        let one_by_one = acted(|network| Simd::vectorize(pulp::Scalar::new(), network));
        assert!(one_by_one.0.iter().all(|x| x.is_finite() && *x != 0.0), "{one_by_one:?}");
        assert_eq!(acted(|network| pulp::Arch::new().dispatch(network)), one_by_one);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert_eq!(acted(|network| Simd::vectorize(simd, network)), one_by_one);
        }
    }

    #[test]
    fn a_layer_gives_weighted_sums_and_its_bias() {
        let layer = Dense::new(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &[0.5, -0.5]);
        let mut y = Vec::new();
        layer.apply_resized(pulp::Scalar::new(), &[1.0, 0.0, -1.0, 2.0, 1.0, 0.0], &mut y);
        // 1 - 3 + 0.5, 4 - 6 - 0.5; 2 + 2 + 0.5, 8 + 5 - 0.5
        assert_eq!(y, [-1.5, -2.5, 4.5, 12.5]);
    }
}
