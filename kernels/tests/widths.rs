//! Results have the same bits at every register width and in every batch.

use kernels::{
    Activation, Input, Layer, Network, Packed, SequenceLayout, Width, Workspace, select,
};

/// Pseudo-random numbers in `(-1, 1)`.
fn numbers(count: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / 8_388_608.0 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

/// [`mlp`] with a layer norm at the input.
fn normed_mlp(inputs: usize, width: usize, outputs: usize) -> Network {
    let norm = Layer::Norm { width: inputs };
    Network::new([&[norm], mlp(inputs, width, outputs).layers()].concat())
}

fn mlp(inputs: usize, width: usize, outputs: usize) -> Network {
    let mut layers = Vec::new();
    let mut from = inputs;
    for _ in 0..2 {
        layers.push(Layer::Linear { inputs: from, outputs: width, activation: Activation::Relu });
        layers.push(Layer::Norm { width });
        from = width;
    }
    layers.push(Layer::Linear { inputs: from, outputs, activation: Activation::Identity });
    Network::new(layers)
}

fn gru(inputs: usize, hidden: usize, outputs: usize) -> Network {
    Network::new(vec![
        Layer::Norm { width: inputs },
        Layer::Linear { inputs, outputs: hidden, activation: Activation::Tanh },
        Layer::Gru { inputs: hidden, hidden },
        Layer::Norm { width: hidden },
        Layer::Linear { inputs: hidden, outputs, activation: Activation::Identity },
    ])
}

/// Output, gradient of the parameters and gradient of the input of one pass, as bits.
fn pass(network: &Network, rows: usize, sequences: usize) -> Vec<u32> {
    let packed = Packed::new(network, &numbers(network.parameters(), 1));
    let input = numbers(rows * network.inputs(), 2);
    let start = numbers(sequences * network.gru().map_or(0, |(_, hidden)| hidden), 3);
    let mask: Vec<f32> = (0..rows).map(|row| f32::from(u8::from(row % 7 != 3))).collect();
    let sequences =
        network.gru().map(|_| SequenceLayout { start: &start, mask: &mask, count: sequences });
    let mut workspace = Workspace::default();
    packed.forward(Input { rows: &input, sequences }, &mut workspace);
    let mut all = Vec::new();
    workspace.append_output(&mut all);
    workspace.append_features(&mut all);
    let mut gradient = numbers(network.parameters(), 5);
    let output = numbers(rows * network.outputs(), 4);
    let mut by_input = Vec::new();
    packed.backward(&output, sequences, &mut workspace, Some(&mut gradient), Some(&mut by_input));
    assert_eq!(by_input.len(), input.len());
    all.extend(gradient);
    all.extend(by_input);
    all.into_iter().map(f32::to_bits).collect()
}

fn cases() -> Vec<(Network, usize, usize)> {
    let mut cases = vec![
        (normed_mlp(1, 1, 1), 1, 0),
        (normed_mlp(17, 33, 2), 7, 0),
        (mlp(23, 64, 3), 37, 0),
        (mlp(9, 64, 6), 4, 0),
        (gru(1, 1, 1), 3, 3),
        (gru(17, 17, 3), 15, 3),
    ];
    if !cfg!(miri) {
        cases.extend([
            (normed_mlp(111, 100, 5), 250, 0),
            (normed_mlp(23, 128, 3), 513, 0),
            (gru(111, 64, 2), 250, 25),
            (gru(19, 33, 6), 300, 1),
        ]);
    }
    cases
}

#[test]
fn every_width_of_this_processor_gives_the_bits_of_the_scalar_code() {
    for (network, rows, sequences) in cases() {
        assert!(select(Width::Scalar));
        let expected = pass(&network, rows, sequences);
        for width in Width::ALL.into_iter().filter(|&width| select(width)) {
            let same = pass(&network, rows, sequences) == expected;
            assert!(same, "{} differs, {rows} rows of {network:?}", width.name());
        }
    }
}

#[test]
fn gradients_are_one_chain_over_rows_in_any_batch() {
    let network = normed_mlp(19, 48, 3);
    let packed = Packed::new(&network, &numbers(network.parameters(), 1));
    let rows = if cfg!(miri) { 9 } else { 300 };
    let (input, output) = (numbers(rows * 19, 2), numbers(rows * 3, 3));
    let found = |size: usize| {
        let (mut workspace, mut gradient) = (Workspace::default(), vec![0.0; network.parameters()]);
        for (input, output) in input.chunks(size * 19).zip(output.chunks(size * 3)) {
            packed.forward(Input { rows: input, sequences: None }, &mut workspace);
            packed.backward(output, None, &mut workspace, Some(&mut gradient), None);
        }
        gradient
    };
    let whole = found(rows);
    for size in [1, 7, 128] {
        assert_eq!(found(size), whole, "batches of {size}");
    }
}

#[test]
fn nan_in_a_row_stays_in_that_row() {
    let network = normed_mlp(5, 16, 2);
    let packed = Packed::new(&network, &numbers(network.parameters(), 1));
    let mut input = numbers(20, 2);
    input[7] = f32::NAN;
    let (mut workspace, mut output) = (Workspace::default(), Vec::new());
    packed.forward(Input { rows: &input, sequences: None }, &mut workspace);
    workspace.append_output(&mut output);
    let nan: Vec<bool> = output.iter().map(|x| x.is_nan()).collect();
    assert_eq!(nan, [false, false, true, true, false, false, false, false]);
}
