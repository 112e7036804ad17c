//! A gated recurrent unit over the steps of several sequences.

use crate::buffer::{PaddedRows, padded, stride};
use crate::linear::{LinearWeights, add_rows, slope_of_tanh};
use crate::math::{sigmoid_of, tanh_of};
use crate::product::InitialSum;
use crate::simd::{Line, Simd};

/// Gates r, z, n.
const GATES: usize = 3;

/// Weights of both linear maps, separate for each gate.
#[derive(Clone, Debug)]
pub(crate) struct Gru {
    inputs: usize,
    hidden: usize,
    input: [LinearWeights; GATES],
    recurrent: [LinearWeights; GATES],
    /// For r and z the sum of both biases, for n that of the input.
    input_bias: [Vec<Line>; GATES],
    /// Bias of n's recurrent part.
    candidate_bias: Vec<Line>,
}

/// Values that the forward pass saves for the backward pass, rows `t * B + b`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trace {
    /// r, z, n, and `W_hn h' + b_hn`. The backward pass overwrites them with the gradients of their pre-activations.
    gates: [PaddedRows; GATES + 1],
    /// `h'` of every step.
    before: PaddedRows,
    /// The initial state, `[B, H]`. In the backward pass, its gradient.
    state: PaddedRows,
}

/// How rows form sequences: `T` steps of `B` sequences, rows `t * B + b`.
#[derive(Clone, Copy, Debug)]
pub struct SequenceLayout<'a> {
    /// The recurrent state before the first step, `[B, H]`.
    pub start: &'a [f32],
    /// 0 where the state is reset before the step, else 1, `[T, B]`.
    pub mask: &'a [f32],
    /// `B`
    pub count: usize,
}

impl SequenceLayout<'_> {
    pub(crate) fn steps(&self) -> usize {
        self.mask.len() / self.count.max(1)
    }
}

impl Gru {
    /// From the concatenation of `W_i`, `b_i`, `W_h`, `b_h`.
    pub(crate) fn new(parameters: &[f32], inputs: usize, hidden: usize) -> Self {
        let (input, rest) = parameters.split_at(GATES * hidden * inputs);
        let (input_bias, rest) = rest.split_at(GATES * hidden);
        let (recurrent, recurrent_bias) = rest.split_at(GATES * hidden * hidden);
        let gate = |of: &[f32], width: usize, gate: usize| {
            LinearWeights::new(&of[gate * hidden * width..][..hidden * width], width, hidden)
        };
        let bias = |gate: usize| {
            let own = &input_bias[gate * hidden..][..hidden];
            let other = &recurrent_bias[gate * hidden..][..hidden];
            let sum = |(own, other): (&f32, &f32)| own + other;
            match gate {
                2 => padded(own),
                _ => padded(&own.iter().zip(other).map(sum).collect::<Vec<f32>>()),
            }
        };
        Self {
            inputs,
            hidden,
            input: core::array::from_fn(|index| gate(input, inputs, index)),
            recurrent: core::array::from_fn(|index| gate(recurrent, hidden, index)),
            input_bias: core::array::from_fn(bias),
            candidate_bias: padded(&recurrent_bias[2 * hidden..]),
        }
    }

    /// Writes the states after every step.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(
        &self,
        simd: S,
        x: &PaddedRows,
        sequences: SequenceLayout<'_>,
        states: &mut PaddedRows,
        trace: &mut Trace,
    ) {
        let SequenceLayout { start, mask, count } = sequences;
        let rows = sequences.steps() * count;
        trace.before.resize(rows, self.hidden);
        trace.state.resize(count, self.hidden);
        trace.state.fill(0, start);
        trace.gates.iter_mut().for_each(|gate| gate.resize(rows, self.hidden));
        for (gate, weights) in self.input.iter().enumerate() {
            let start = InitialSum::Bias(&self.input_bias[gate]);
            let into = trace.gates[gate].range_mut(0, rows);
            simd.outlined(&weights.forward(x.range(0, rows), into, rows, start));
        }
        for step in 0..sequences.steps() {
            let from = step * count;
            let to = (step + 1) * count;
            let earlier = match step {
                0 => trace.state.range(0, count),
                _ => states.range(from - count, from),
            };
            let before = trace.before.range_mut(from, to);
            masked(simd, earlier, before, &mask[from..to], stride(self.hidden));
            let before = trace.before.range(from, to);
            for (gate, weights) in self.recurrent.iter().enumerate() {
                let (place, start) = match gate {
                    2 => (3, InitialSum::Bias(&self.candidate_bias)),
                    _ => (gate, InitialSum::Result),
                };
                let into = trace.gates[place].range_mut(from, to);
                simd.outlined(&weights.forward(before, into, count, start));
            }
            let gates = trace.gates.each_mut().map(|gate| gate.range_mut(from, to));
            cells(simd, gates, before, states.range_mut(from, to));
        }
    }

    /// Backpropagation through time from the gradient `g` of the states: replaces the gates in `trace` by the gradients of
    /// their pre-activations, last step first.
    #[inline(always)]
    pub(crate) fn backward<S: Simd>(
        &self,
        simd: S,
        sequences: SequenceLayout<'_>,
        g: &PaddedRows,
        trace: &mut Trace,
    ) {
        let SequenceLayout { mask, count, .. } = sequences;
        trace.state.range_mut(0, count).fill(Line::default());
        for step in (0..sequences.steps()).rev() {
            let from = step * count;
            let to = (step + 1) * count;
            let gates = trace.gates.each_mut().map(|gate| gate.range_mut(from, to));
            let before = trace.before.range(from, to);
            cells_backward(simd, gates, before, g.range(from, to), trace.state.range_mut(0, count));
            for (gate, weights) in self.recurrent.iter().enumerate() {
                let place = if gate == 2 { 3 } else { gate };
                let d = trace.gates[place].range(from, to);
                let later = trace.state.range_mut(0, count);
                simd.outlined(&weights.backward(d, later, count, InitialSum::Result));
            }
            let later = trace.state.range_mut(0, count);
            reset(simd, later, &mask[from..to], stride(self.hidden));
        }
    }

    /// After [`Self::backward`]: writes the gradient of the input.
    #[inline(always)]
    pub(crate) fn input_gradient<S: Simd>(
        &self,
        simd: S,
        rows: usize,
        trace: &Trace,
        dx: &mut PaddedRows,
    ) {
        dx.resize(rows, self.inputs);
        for (gate, weights) in self.input.iter().enumerate() {
            let start = if gate == 0 { InitialSum::Zero } else { InitialSum::Result };
            let d = trace.gates[gate].range(0, rows);
            simd.outlined(&weights.backward(d, dx.range_mut(0, rows), rows, start));
        }
    }

    /// After [`Self::backward`]: adds to the gradient of the parameters.
    #[inline(always)]
    pub(crate) fn add_gradient<S: Simd>(
        &self,
        simd: S,
        x: &PaddedRows,
        rows: usize,
        trace: &Trace,
        parameters: &mut [f32],
    ) {
        let (inputs, hidden) = (self.inputs, self.hidden);
        let (input, rest) = parameters.split_at_mut(GATES * hidden * inputs);
        let (input_bias, rest) = rest.split_at_mut(GATES * hidden);
        let (recurrent, recurrent_bias) = rest.split_at_mut(GATES * hidden * hidden);
        for gate in 0..GATES {
            let d = trace.gates[gate].range(0, rows);
            let into = &mut input[gate * hidden * inputs..][..hidden * inputs];
            simd.outlined(&self.input[gate].gradient(d, x.range(0, rows), rows, into));
            add_rows(simd, d, &mut input_bias[gate * hidden..][..hidden]);
            let d = trace.gates[if gate == 2 { 3 } else { gate }].range(0, rows);
            let into = &mut recurrent[gate * hidden * hidden..][..hidden * hidden];
            let before = trace.before.range(0, rows);
            simd.outlined(&self.recurrent[gate].gradient(d, before, rows, into));
            add_rows(simd, d, &mut recurrent_bias[gate * hidden..][..hidden]);
        }
    }
}

/// `to = from * mask`, with one mask value per row.
#[inline(always)]
fn masked<S: Simd>(simd: S, from: &[Line], to: &mut [Line], mask: &[f32], stride: usize) {
    let rows = from.chunks_exact(stride).zip(to.chunks_exact_mut(stride));
    for ((from, to), &mask) in rows.zip(mask) {
        for (from, to) in from.iter().zip(to) {
            simd.store(simd.mul(simd.load(from), simd.splat(mask)), to);
        }
    }
}

#[inline(always)]
fn reset<S: Simd>(simd: S, rows: &mut [Line], mask: &[f32], stride: usize) {
    for (row, &mask) in rows.chunks_exact_mut(stride).zip(mask) {
        for line in row {
            simd.store(simd.mul(simd.load(line), simd.splat(mask)), line);
        }
    }
}

/// As in [`Trace`].
type Gates<'a> = [&'a mut [Line]; GATES + 1];

/// Replaces pre-activations by gates and writes the states.
#[inline(always)]
fn cells<S: Simd>(simd: S, gates: Gates<'_>, before: &[Line], states: &mut [Line]) {
    let [r, z, n, candidate] = gates;
    let gates = r.iter_mut().zip(z).zip(n.iter_mut().zip(candidate));
    for (((r, z), (n, candidate)), (before, state)) in gates.zip(before.iter().zip(states)) {
        let reset = sigmoid_of(simd, simd.load(r));
        let keep = sigmoid_of(simd, simd.load(z));
        let new = tanh_of(simd, simd.fma(reset, simd.load(candidate), simd.load(n)));
        simd.store(reset, r);
        simd.store(keep, z);
        simd.store(new, n);
        simd.store(simd.fma(keep, simd.sub(simd.load(before), new), new), state);
    }
}

/// Replaces the gates by the gradients of their pre-activations. `g` is the gradient of the states from the next layer.
/// `later` is the one from the next step; it is replaced by the direct part of the gradient of `before`, `h'`.
#[inline(always)]
fn cells_backward<S: Simd>(
    simd: S,
    gates: Gates<'_>,
    before: &[Line],
    g: &[Line],
    later: &mut [Line],
) {
    let [r, z, n, candidate] = gates;
    let one = simd.splat(1.0);
    let gates = r.iter_mut().zip(z).zip(n.iter_mut().zip(candidate));
    let known = g.iter().zip(before).zip(later);
    for (((r, z), (n, candidate)), ((g, before), later)) in gates.zip(known) {
        let reset = simd.load(r);
        let keep = simd.load(z);
        let new = simd.load(n);
        let d = simd.add(simd.load(g), simd.load(later));
        let rest = simd.sub(one, keep);
        let through_keep = simd.mul(simd.mul(d, simd.sub(simd.load(before), new)), keep);
        let d_new = simd.mul(simd.mul(d, rest), slope_of_tanh(simd, new));
        let through_reset = simd.mul(simd.mul(d_new, simd.load(candidate)), reset);
        simd.store(simd.mul(through_reset, simd.sub(one, reset)), r);
        simd.store(simd.mul(through_keep, rest), z);
        simd.store(d_new, n);
        simd.store(simd.mul(d_new, reset), candidate);
        simd.store(simd.mul(d, keep), later);
    }
}
