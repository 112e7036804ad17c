//! Forward and backward pass of a network with given weights.

use core::ops::Range;

use crate::buffer::{PaddedRows, stride};
use crate::gru::{Gru, SequenceLayout};
use crate::linear::Linear;
use crate::network::{Layer, Network};
use crate::norm::{Norm, RowMoments};
use crate::simd::{Line, Operation, Simd};
use crate::width;
use crate::workspace::Workspace;

/// Rows of a block, which passes through all layers while it is in cache.
const BLOCK: usize = 128;

/// A network with its weights in the order in which the kernel reads them.
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

/// Input of a network.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// `[rows, inputs]`
    pub rows: &'a [f32],
    /// Required by a network with a GRU, otherwise ignored.
    pub sequences: Option<SequenceLayout<'a>>,
}

impl Packed {
    /// Packs the parameters of all layers, in the order of [`Layer`].
    ///
    /// # Panics
    /// If the number of parameters is wrong.
    #[must_use]
    pub fn new(network: &Network, parameters: &[f32]) -> Self {
        assert_eq!(parameters.len(), network.parameters(), "parameters of {network:?}");
        let ranges = network.ranges();
        let part = |(layer, range): (&Layer, &Range<usize>)| {
            let own = &parameters[range.clone()];
            match *layer {
                Layer::Norm { .. } => Part::Norm(Norm::new(own)),
                Layer::Linear { inputs, outputs, activation } => {
                    Part::Linear(Linear::new(own, inputs, outputs, activation))
                }
                Layer::Gru { inputs, hidden } => Part::Gru(Box::new(Gru::new(own, inputs, hidden))),
            }
        };
        let layers = network.layers().iter().zip(&ranges).map(part).collect();
        Self { network: network.clone(), ranges, layers }
    }

    /// The network without its weights.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Computes every layer's result for all rows and stores them in `workspace`.
    ///
    /// # Panics
    /// If the input does not fit the network.
    pub fn forward(&self, input: Input<'_>, workspace: &mut Workspace) {
        let rows = self.check(input);
        workspace.rows = rows;
        workspace.activations.resize_with(self.layers.len() + 1, PaddedRows::default);
        workspace.moments.resize_with(self.layers.len(), Vec::new);
        workspace.activations[0].resize(rows, self.network.inputs());
        workspace.activations[0].fill(0, input.rows);
        for (index, layer) in self.network.layers().iter().enumerate() {
            workspace.activations[index + 1].resize(rows, layer.outputs());
            if matches!(layer, Layer::Norm { .. }) {
                workspace.moments[index].resize(rows, RowMoments::default());
            }
        }
        if rows > 0 {
            width().run(Forward { packed: self, sequences: input.sequences, workspace });
        }
    }

    /// Checks the input's lengths and returns the number of rows.
    fn check(&self, input: Input<'_>) -> usize {
        let rows = input.rows.len() / self.network.inputs();
        let inputs = self.network.inputs();
        assert_eq!(rows * inputs, input.rows.len(), "rows of {inputs} numbers");
        match (self.network.gru(), input.sequences) {
            (Some((_, hidden)), Some(given)) => {
                assert_eq!(given.mask.len(), rows, "one mask value per row");
                assert_eq!(given.start.len(), given.count * hidden, "one state per sequence");
                assert_eq!(given.steps() * given.count, rows, "sequences of equal length");
            }
            (Some(_), None) => panic!("a network with a GRU needs states and a mask"),
            (None, _) => {}
        }
        rows
    }

    /// Backward pass from the gradient of the output, `[rows, outputs]`, through the forward pass in `workspace`; at most
    /// once per forward pass, with the same `sequences`. Adds to `parameters` the gradient of the parameters, and appends
    /// to `input` the gradient of the input, `[rows, inputs]`, if given.
    ///
    /// # Panics
    /// If a length is wrong.
    pub fn backward(
        &self,
        output: &[f32],
        sequences: Option<SequenceLayout<'_>>,
        workspace: &mut Workspace,
        parameters: Option<&mut [f32]>,
        input: Option<&mut Vec<f32>>,
    ) {
        let rows = workspace.rows;
        assert_eq!(output.len(), rows * self.network.outputs(), "a gradient of {rows} rows");
        let wanted = self.network.parameters();
        assert!(parameters.as_ref().is_none_or(|all| all.len() == wanted), "{wanted} parameters");
        if rows == 0 {
            return;
        }
        workspace.gradients[0].resize(rows, self.network.outputs());
        workspace.gradients[0].fill(0, output);
        let by_input = input.is_some();
        width().run(Backward { packed: self, sequences, workspace, parameters, by_input });
        if let Some(input) = input {
            workspace.gradients[0].append_to(0, rows, input);
        }
    }

    /// The layers before the GRU, the GRU, and the layers after it. A GRU processes all rows at once, other segments
    /// process them in blocks.
    fn segments(&self) -> Vec<Range<usize>> {
        let end = self.layers.len();
        let (gru, after) = self.network.gru().map_or((end, end), |(gru, _)| (gru, gru + 1));
        [0..gru, gru..after, after..end].into_iter().filter(|range| !range.is_empty()).collect()
    }
}

struct Forward<'a> {
    packed: &'a Packed,
    sequences: Option<SequenceLayout<'a>>,
    workspace: &'a mut Workspace,
}

impl Operation for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { packed, sequences, workspace } = self;
        for segment in packed.segments() {
            match (&packed.layers[segment.start], sequences) {
                (Part::Gru(gru), Some(sequences)) => {
                    let (before, after) = workspace.activations.split_at_mut(segment.start + 1);
                    let x = &before[segment.start];
                    let states = &mut after[0];
                    gru.forward(simd, x, sequences, states, &mut workspace.trace);
                }
                _ => {
                    for from in (0..workspace.rows).step_by(BLOCK) {
                        let to = (from + BLOCK).min(workspace.rows);
                        for index in segment.clone() {
                            forward_block(simd, packed, index, from..to, workspace);
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
    rows: Range<usize>,
    workspace: &mut Workspace,
) {
    let (before, after) = workspace.activations.split_at_mut(index + 1);
    let x = before[index].range(rows.start, rows.end);
    let y = after[0].range_mut(rows.start, rows.end);
    match &packed.layers[index] {
        Part::Norm(norm) => norm.forward(simd, x, y, &mut workspace.moments[index][rows]),
        Part::Linear(linear) => linear.forward(simd, x, y, rows.len()),
        Part::Gru(_) => unreachable!("a GRU is a separate segment"),
    }
}

struct Backward<'a> {
    packed: &'a Packed,
    sequences: Option<SequenceLayout<'a>>,
    workspace: &'a mut Workspace,
    parameters: Option<&'a mut [f32]>,
    /// Whether the gradient of the network's input is computed.
    by_input: bool,
}

impl Operation for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        for segment in self.packed.segments().into_iter().rev() {
            match (&self.packed.layers[segment.start], self.sequences) {
                (Part::Gru(gru), Some(sequences)) => {
                    self.gru(simd, gru, segment.start, sequences);
                }
                _ => self.segment(simd, segment),
            }
        }
    }
}

impl Backward<'_> {
    #[inline(always)]
    fn gru<S: Simd>(&mut self, simd: S, gru: &Gru, index: usize, sequences: SequenceLayout<'_>) {
        let Workspace { rows, activations, trace, gradients: [g, dx], .. } = &mut *self.workspace;
        gru.backward(simd, sequences, g, trace);
        if let Some(parameters) = self.parameters.as_deref_mut() {
            let own = &mut parameters[self.packed.ranges[index].clone()];
            gru.add_gradient(simd, &activations[index], *rows, trace, own);
        }
        gru.input_gradient(simd, *rows, trace, dx);
        self.workspace.gradients.swap(0, 1);
    }

    /// Takes blocks of rows back through `segment`: from the gradient of its result to that of its input, if needed.
    #[inline(always)]
    fn segment<S: Simd>(&mut self, simd: S, segment: Range<usize>) {
        let Self { packed, workspace, parameters, by_input, .. } = self;
        let needed = *by_input || segment.start > 0;
        let Workspace { rows, activations, moments, gradients, blocks: [g, dx], .. } =
            &mut **workspace;
        if needed {
            gradients[1].resize(*rows, packed.network.layers()[segment.start].inputs());
        }
        for from in (0..*rows).step_by(BLOCK) {
            let to = (from + BLOCK).min(*rows);
            g.clear();
            g.extend_from_slice(gradients[0].range(from, to));
            for index in segment.clone().rev() {
                let width = packed.network.layers()[index].inputs();
                dx.resize((to - from) * stride(width), Line::default());
                let x = &activations[index];
                let y = &activations[index + 1];
                debug_assert_eq!(x.width(), width, "the workspace of another network");
                let (x, y) = (x.range(from, to), y.range(from, to));
                let range = packed.ranges[index].clone();
                let own = parameters.as_deref_mut().map(|all| &mut all[range]);
                let by_x = (needed || index > segment.start).then_some(dx.as_mut_slice());
                match &packed.layers[index] {
                    Part::Norm(norm) => {
                        norm.backward(simd, x, g, &moments[index][from..to], own, by_x);
                    }
                    Part::Linear(linear) => linear.backward(simd, x, y, g, own, by_x),
                    Part::Gru(_) => unreachable!("a GRU is a separate segment"),
                }
                core::mem::swap(g, dx);
            }
            if needed {
                gradients[1].range_mut(from, to).copy_from_slice(g);
            }
        }
        if needed {
            gradients.swap(0, 1);
        }
    }
}
