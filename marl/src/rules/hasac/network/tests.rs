//! Passes against the definition of batch norm, computed row by row in double precision, and its finite differences.

use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

use super::*;
use crate::sample;

/// More rows than a shard has, in three shards of different sizes.
const ROWS: usize = 400;
const INPUTS: usize = 3;

fn normals(count: usize, step: u32) -> Vec<f32> {
    let mut rng = generator(RunSeed(4), Draw::of(Purpose::Probe).step(step));
    (0..count).map(|_| standard_normal(&mut rng)).collect()
}

/// Columns with means and deviations that are not 0 and 1.
fn input() -> Vec<f32> {
    let rows = normals(ROWS * INPUTS, 1);
    let scaled = rows.chunks_exact(INPUTS).flat_map(|x| [3.0 + x[0], 0.1 * x[1], 5.0 * x[2] - 2.0]);
    scaled.collect()
}

/// Two hidden layers of five units and two outputs; scales, shifts and biases are not those of a new network.
fn network(momentum: f64) -> NormalisedNetwork {
    let adam = AdamConfig { learning_rate: 0.1, epsilon: 1e-8, max_gradient_norm: 1e9 };
    let usual = sample::config().hasac.unwrap();
    let own = HasacConfig { norm_momentum: momentum, first_moment: 0.9, ..usual };
    let mut rng = generator(RunSeed(5), Draw::of(Purpose::CriticInitialisation));
    let network = NormalisedNetwork::new((INPUTS, 5, 2, 2), (adam, &own), &mut rng).unwrap();
    let mut values = network.parameters.values().unwrap();
    let noise = normals(values[0].len(), 2);
    values[0].iter_mut().zip(noise).for_each(|(value, noise)| *value += 0.2 * noise);
    network.parameters.set(values).unwrap();
    network
}

/// The definition: every layer's input normalised by `moments`, scaled and shifted, then the linear map.
fn reference(
    network: &NormalisedNetwork,
    rows: &[f32],
    moments: impl Fn(usize, &[Vec<f64>]) -> Vec<(f64, f64)>,
) -> Vec<f64> {
    let parameters = network.parameters.values().unwrap().concat();
    let wide = |x: &[f32]| x.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
    let mut rows: Vec<Vec<f64>> = rows.chunks_exact(INPUTS).map(wide).collect();
    for (index, layer) in network.layers.iter().enumerate() {
        let own = wide(&parameters[layer.range.clone()]);
        let LinearShape { inputs, outputs, .. } = layer.shape;
        let (norm, linear) = own.split_at(2 * inputs);
        let moments = moments(index, &rows);
        let output = |x: &Vec<f64>| {
            let normal = |j: usize| {
                let (mean, variance) = moments[j];
                (x[j] - mean) / libm::sqrt(variance + 1e-5) * norm[j] + norm[inputs + j]
            };
            let sum = |o: usize| {
                let weight = &linear[o * inputs..(o + 1) * inputs];
                let products = weight.iter().enumerate().map(|(j, weight)| weight * normal(j));
                linear[inputs * outputs + o] + products.sum::<f64>()
            };
            let last = index + 1 == network.layers.len();
            (0..outputs).map(|o| if last { sum(o) } else { sum(o).max(0.0) }).collect()
        };
        rows = rows.iter().map(output).collect();
    }
    rows.concat()
}

/// Mean and biased variance of every column.
fn batch_moments(_layer: usize, rows: &[Vec<f64>]) -> Vec<(f64, f64)> {
    let share = 1.0 / rows.len() as f64;
    let column = |j: usize| {
        let mean = share * rows.iter().map(|row| row[j]).sum::<f64>();
        let squares = rows.iter().map(|row| (row[j] - mean) * (row[j] - mean));
        (mean, share * squares.sum::<f64>())
    };
    (0..rows[0].len()).map(column).collect()
}

/// The running statistics of a layer.
fn running(network: &NormalisedNetwork) -> impl Fn(usize, &[Vec<f64>]) -> Vec<(f64, f64)> {
    |layer, _| {
        let ColumnMoments { mean, variance } = &network.layers[layer].running;
        mean.iter().copied().zip(variance.iter().copied()).collect()
    }
}

fn assert_close(found: &[f32], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        let error = (f64::from(*found) - expected).abs();
        assert!(error < 2e-5 * (1.0 + expected.abs()), "{found}, expected {expected}");
    }
}

#[test]
fn a_training_pass_is_that_of_the_normalised_network() {
    let mut network = network(0.25);
    let output = network.forward(&input()).unwrap();
    assert_close(&output, &reference(&network, &input(), batch_moments));
    // From mean 0 and variance 1 a quarter of the way, to the unbiased variance.
    let rows: Vec<Vec<f64>> =
        input().chunks_exact(INPUTS).map(|x| x.iter().map(|&x| f64::from(x)).collect()).collect();
    let running = &network.layers[0].running;
    for (j, (mean, variance)) in batch_moments(0, &rows).into_iter().enumerate() {
        assert!((running.mean[j] - 0.25 * mean).abs() < 1e-9);
        assert!((running.variance[j] - 0.75 - 0.25 * variance * 400.0 / 399.0).abs() < 1e-9);
    }
}

#[test]
fn the_folded_network_is_the_normalised_one_with_running_statistics() {
    let mut network = network(0.3);
    for _ in 0..5 {
        network.forward(&input()).unwrap();
    }
    let mut frozen = network.frozen().unwrap();
    assert_close(&frozen.forward(&input()), &reference(&network, &input(), running(&network)));
}

/// Gradient of `sum w y + 0.1 y^2` over the outputs `y` of the first half of the rows: the second half counts only
/// through the statistics.
fn loss_gradient(output: &[f32]) -> Vec<f32> {
    let weights = normals(output.len(), 3);
    let mut gradient: Vec<f32> =
        output.iter().zip(weights).map(|(x, weight)| weight + 0.2 * x).collect();
    gradient[output.len() / 2..].fill(0.0);
    gradient
}

#[test]
fn gradients_of_all_parameters_meet_finite_differences_through_the_statistics_of_both_halves() {
    let mut network = network(0.01);
    let output = network.forward(&input()).unwrap();
    let Gradients(gradients) = network.backward(&loss_gradient(&output)).unwrap();
    // The definition in double precision has no rounding errors to speak of, and no kinks at these points.
    let start = network.parameters.values().unwrap();
    for at in 0..start[0].len() {
        let moved = |by: f32| {
            let mut values = start.clone();
            values[0][at] += by;
            let value = f64::from(values[0][at]);
            network.parameters.set(values).unwrap();
            let output = reference(&network, &input(), batch_moments);
            let half = output[..output.len() / 2].iter().zip(normals(output.len(), 3));
            let loss: f64 = half.map(|(x, weight)| x * f64::from(weight) + 0.1 * x * x).sum();
            (value, loss)
        };
        let (above, below) = (moved(1e-4), moved(-1e-4));
        let slope = (above.1 - below.1) / (above.0 - below.0);
        let found = f64::from(gradients[0][at]);
        assert!((found - slope).abs() < 2e-3 * (1.0 + slope.abs()), "{at}: {found}, {slope}");
    }
    network.parameters.set(start).unwrap();
}

#[test]
fn gradients_of_a_frozen_networks_input_meet_finite_differences() {
    let mut network = network(0.3);
    network.forward(&input()).unwrap();
    let mut frozen = network.frozen().unwrap();
    let output = frozen.forward(&input());
    let found = frozen.input_gradient(&loss_gradient(&output));
    let start = input();
    for at in (0..start.len() / 2).step_by(7) {
        let row = at / INPUTS;
        let moved = |by: f32| {
            let mut own = start[row * INPUTS..(row + 1) * INPUTS].to_vec();
            own[at % INPUTS] += by;
            let output = reference(&network, &own, running(&network));
            let weights = normals(2 * ROWS, 3);
            let pairs = output.iter().zip(&weights[2 * row..]);
            let loss = pairs.map(|(x, &weight)| x * f64::from(weight) + 0.1 * x * x);
            (f64::from(own[at % INPUTS]), loss.sum::<f64>())
        };
        let (above, below) = (moved(1e-5), moved(-1e-5));
        let slope = (above.1 - below.1) / (above.0 - below.0);
        let error = (f64::from(found[at]) - slope).abs();
        assert!(error < 1e-3 * (1.0 + slope.abs()), "{at}: {} {slope}", found[at]);
    }
}

#[test]
fn a_batch_that_is_not_finite_changes_neither_weights_nor_running_statistics() {
    let mut network = network(0.5);
    let before = network.parameters.values().unwrap();
    let mut rows = input();
    rows[4] = f32::INFINITY;
    let output = network.forward(&rows).unwrap();
    network.descend(&loss_gradient(&output)).unwrap();
    assert_eq!(network.skipped(), 1);
    assert_eq!(network.parameters.values().unwrap(), before);
    let finite = |x: &f64| x.is_finite();
    let statistics = network.layers.iter().map(|layer| &layer.running);
    for ColumnMoments { mean, variance } in statistics {
        assert!(mean.iter().all(finite) && variance.iter().all(finite));
    }
}
