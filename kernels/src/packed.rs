//! A network with its weights, forwards and backwards.

use core::ops::Range;

use crate::buffer::{Rows, stride};
use crate::gru::{Gru, Steps};
use crate::linear::Linear;
use crate::network::{Layer, Network};
use crate::norm::Norm;
use crate::simd::{Line, Operation, Simd};
use crate::width;
use crate::workspace::Workspace;

/// Rows that go through all layers while they are in cache.
const BLOCK: usize = 128;

/// A network whose weights are in the order in which registers read them.
#[derive(Clone, Debug)]
pub struct Packed {
    network: Network,
    ranges: Vec<Range<usize>>,
    layers: Vec<Part>,
}

#[derive(Clone, Debug)]
enum Part {
    Norm(Norm),
    Linear(Linear),
    Gru(Box<Gru>),
}

/// Rows that a network is given.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// `[rows, inputs]`
    pub rows: &'a [f32],
    /// Of a network with a GRU.
    pub memory: Option<Memory<'a>>,
}

/// How rows follow each other: `T` steps of `B` sequences, rows `t * B + b`.
#[derive(Clone, Copy, Debug)]
pub struct Memory<'a> {
    /// The recurrent state before the first step, `[B, H]`.
    pub start: &'a [f32],
    /// 0 where the state is reset before the step, else 1, `[T, B]`.
    pub mask: &'a [f32],
    /// `B`
    pub sequences: usize,
}

impl Memory<'_> {
    fn steps(&self) -> Steps<'_> {
        let (sequences, mask) = (self.sequences, self.mask);
        Steps { steps: mask.len() / sequences.max(1), sequences, mask }
    }
}

impl Packed {
    /// Packs all parameters, layer after layer as [`Layer`] orders them.
    ///
    /// # Panics
    /// If they are too few or too many.
    #[must_use]
    pub fn new(network: &Network, parameters: &[f32]) -> Self {
        assert_eq!(parameters.len(), network.parameters(), "parameters of {network:?}");
        let ranges = network.ranges();
        let part = |(layer, range): (&Layer, &Range<usize>)| {
            let own = &parameters[range.clone()];
            match *layer {
                Layer::Norm { .. } => Part::Norm(Norm::new(own)),
                Layer::Linear { inputs, outputs, activation } => {
                    Part::Linear(Linear::new(own, (inputs, outputs), activation))
                }
                Layer::Gru { inputs, hidden } => {
                    Part::Gru(Box::new(Gru::new(own, (inputs, hidden))))
                }
            }
        };
        let layers = network.layers().iter().zip(&ranges).map(part).collect();
        Self { network: network.clone(), ranges, layers }
    }

    /// The network that was packed.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Computes every layer's result for all rows and leaves them in `workspace`.
    ///
    /// # Panics
    /// If the input does not fit the network.
    pub fn forward(&self, input: Input<'_>, workspace: &mut Workspace) {
        let rows = self.check(input);
        workspace.rows = rows;
        workspace.activations.resize_with(self.layers.len() + 1, Rows::default);
        workspace.moments.resize_with(self.layers.len(), Vec::new);
        workspace.activations[0].resize(rows, self.network.inputs());
        workspace.activations[0].fill(0, input.rows);
        for (index, layer) in self.network.layers().iter().enumerate() {
            workspace.activations[index + 1].resize(rows, layer.outputs());
            if matches!(layer, Layer::Norm { .. }) {
                workspace.moments[index].resize(rows, (0.0, 0.0));
            }
        }
        if rows > 0 {
            width().run(Forward { packed: self, memory: input.memory, workspace });
        }
    }

    /// Rows of an input that fits.
    fn check(&self, input: Input<'_>) -> usize {
        let (rows, inputs) = (input.rows.len() / self.network.inputs(), self.network.inputs());
        assert_eq!(rows * inputs, input.rows.len(), "rows of {inputs} numbers");
        match (self.network.gru(), input.memory) {
            (Some((_, hidden)), Some(memory)) => {
                assert_eq!(memory.mask.len(), rows, "a mask for every row");
                assert_eq!(memory.start.len(), memory.sequences * hidden, "a state per sequence");
                let steps = memory.steps().steps;
                assert_eq!(steps * memory.sequences, rows, "as many steps of every sequence");
            }
            (Some(_), None) => panic!("a network with a GRU needs states and resets"),
            (None, _) => {}
        }
        rows
    }

    /// Takes the gradient by the output, `[rows, outputs]`, back through the layers of the forward pass that
    /// `workspace` holds, once; `memory` is that pass's. Adds to the gradient of the parameters, and writes that of the
    /// input, `[rows, inputs]`, where they are asked for.
    ///
    /// # Panics
    /// If a length does not fit.
    pub fn backward(
        &self,
        output: &[f32],
        memory: Option<Memory<'_>>,
        workspace: &mut Workspace,
        parameters: Option<&mut [f32]>,
        input: Option<&mut Vec<f32>>,
    ) {
        let rows = workspace.rows;
        assert_eq!(output.len(), rows * self.network.outputs(), "a gradient by {rows} rows");
        let wanted = self.network.parameters();
        assert!(parameters.as_ref().is_none_or(|all| all.len() == wanted), "{wanted} parameters");
        if rows == 0 {
            return;
        }
        workspace.gradients[0].resize(rows, self.network.outputs());
        workspace.gradients[0].fill(0, output);
        let by_input = input.is_some();
        width().run(Backward { packed: self, memory, workspace, parameters, by_input });
        if let Some(input) = input {
            workspace.gradients[0].append_to(0, rows, input);
        }
    }

    /// Layers between GRUs, which go through blocks of rows, and GRUs, which go through all.
    fn segments(&self) -> Vec<Range<usize>> {
        let end = self.layers.len();
        let (gru, after) = self.network.gru().map_or((end, end), |(gru, _)| (gru, gru + 1));
        [0..gru, gru..after, after..end].into_iter().filter(|range| !range.is_empty()).collect()
    }
}

struct Forward<'a> {
    packed: &'a Packed,
    memory: Option<Memory<'a>>,
    workspace: &'a mut Workspace,
}

impl Operation for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { packed, memory, workspace } = self;
        for segment in packed.segments() {
            match (&packed.layers[segment.start], memory) {
                (Part::Gru(gru), Some(memory)) => {
                    let (before, after) = workspace.activations.split_at_mut(segment.start + 1);
                    let pair = (&before[segment.start], &mut after[0]);
                    let known = (memory.steps(), memory.start);
                    gru.forward(simd, pair, known, &mut workspace.trace);
                }
                _ => {
                    for from in (0..workspace.rows).step_by(BLOCK) {
                        let to = (from + BLOCK).min(workspace.rows);
                        for index in segment.clone() {
                            forward_block(simd, packed, index, (from, to), workspace);
                        }
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn forward_block<S: Simd>(
    simd: S,
    packed: &Packed,
    index: usize,
    (from, to): (usize, usize),
    workspace: &mut Workspace,
) {
    let (before, after) = workspace.activations.split_at_mut(index + 1);
    let (x, y) = (before[index].range(from, to), after[0].range_mut(from, to));
    match &packed.layers[index] {
        Part::Norm(norm) => norm.forward(simd, x, y, &mut workspace.moments[index][from..to]),
        Part::Linear(linear) => linear.forward(simd, x, y, to - from),
        Part::Gru(_) => unreachable!("a GRU is a segment by itself"),
    }
}

struct Backward<'a> {
    packed: &'a Packed,
    memory: Option<Memory<'a>>,
    workspace: &'a mut Workspace,
    parameters: Option<&'a mut [f32]>,
    by_input: bool,
}

impl Operation for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { packed, memory, workspace, mut parameters, by_input } = self;
        for segment in packed.segments().into_iter().rev() {
            let wanted = by_input || segment.start > 0;
            match (&packed.layers[segment.start], memory) {
                (Part::Gru(gru), Some(memory)) => {
                    let range = packed.ranges[segment.start].clone();
                    let own = parameters.as_deref_mut().map(|all| &mut all[range]);
                    let Workspace { activations, trace, gradients: [g, dx], .. } = &mut *workspace;
                    let pair = (&activations[segment.start], &*g);
                    gru.backward(simd, pair, memory.steps(), trace, (own, dx));
                    workspace.gradients.swap(0, 1);
                }
                _ => {
                    let parameters = parameters.as_deref_mut();
                    backward_segment(simd, packed, segment, workspace, (parameters, wanted));
                }
            }
        }
    }
}

/// Takes blocks of rows back through the layers `segment`, from the gradient by the last one's result to that by the
/// first one's input, which is only computed if `wanted`.
#[inline(always)]
fn backward_segment<S: Simd>(
    simd: S,
    packed: &Packed,
    segment: Range<usize>,
    workspace: &mut Workspace,
    (mut parameters, wanted): (Option<&mut [f32]>, bool),
) {
    let rows = workspace.rows;
    if wanted {
        let inputs = packed.network.layers()[segment.start].inputs();
        workspace.gradients[1].resize(rows, inputs);
    }
    for from in (0..rows).step_by(BLOCK) {
        let to = (from + BLOCK).min(rows);
        let Workspace { activations, moments, gradients, blocks, .. } = &mut *workspace;
        let [g, dx] = blocks;
        g.clear();
        g.extend_from_slice(gradients[0].range(from, to));
        for index in segment.clone().rev() {
            let width = packed.network.layers()[index].inputs();
            let needed = index > segment.start || wanted;
            dx.resize((to - from) * stride(width), Line::default());
            let (x, y) = (&activations[index], &activations[index + 1]);
            debug_assert_eq!(x.width(), width, "the workspace of another network");
            let (x, y) = (x.range(from, to), y.range(from, to));
            let own = parameters.as_deref_mut().map(|all| &mut all[packed.ranges[index].clone()]);
            let by_input = needed.then_some(dx.as_mut_slice());
            match &packed.layers[index] {
                Part::Norm(norm) => {
                    let known = (x, g.as_slice(), &moments[index][from..to]);
                    norm.backward(simd, known, own, by_input);
                }
                Part::Linear(linear) => {
                    let known = (x, y, g.as_mut_slice());
                    linear.backward(simd, known, to - from, own, by_input);
                }
                Part::Gru(_) => unreachable!("a GRU is a segment by itself"),
            }
            core::mem::swap(g, dx);
        }
        if wanted {
            gradients[1].range_mut(from, to).copy_from_slice(g);
        }
    }
    if wanted {
        workspace.gradients.swap(0, 1);
    }
}
