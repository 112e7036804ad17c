//! A recurrent critic's values, states and gradients.

use candle_core::Tensor;
use policy::RunSeed;
use policy::arrays::{Array, NamedArrays};
use policy::randomness::{Draw, Purpose, generator, standard_normal};
use rand::RngCore;

use super::*;
use crate::config::{CriticConfig, CriticCore, StateNorm};
use crate::critic::{FitData, Values};
use crate::data::batch::Final;
use crate::optimisation::gradient::Gradients;
use crate::optimisation::tests::meets_finite_differences;
use crate::sample;
use crate::state::{restored, saved};

const INPUTS: usize = 3;
const VALUES: usize = 2;
const WIDTH: usize = 5;
const STEPS: usize = 6;
const ENVIRONMENTS: usize = 3;
const CHUNK: usize = 3;
/// Truncations, (step, environment): inside a chunk, at a chunk's last step, at the rollout's last step.
const ENDS: [(usize, usize); 3] = [(1, 0), (2, 1), (5, 2)];

fn config() -> CriticConfig {
    let usual = sample::config().critic;
    CriticConfig { core: CriticCore::Gru, width: WIDTH, layers: 1, ..usual }
}

fn critic(config: &CriticConfig) -> Critic {
    let sizes = (INPUTS, VALUES);
    Critic::new(config, (1e-5, CHUNK), sizes, RunSeed(3)).unwrap()
}

fn normals(count: usize, rng: &mut impl RngCore) -> Vec<f32> {
    (0..count).map(|_| standard_normal(rng)).collect()
}

/// A rollout of random states; `number` selects it.
fn rollout(number: u32, steps: usize, ends: &[(usize, usize)]) -> Batch {
    let mut rng = generator(RunSeed(5), Draw::of(Purpose::Probe).step(number));
    let rows = steps * ENVIRONMENTS;
    let place = |row: usize| (row / ENVIRONMENTS, row % ENVIRONMENTS);
    let truncated: Vec<bool> = (0..rows).map(|row| ends.contains(&place(row))).collect();
    let state = normals(rows * INPUTS, &mut rng);
    let finals = (0..rows).filter(|&row| truncated[row] || place(row).0 + 1 == steps);
    let mut last = |row| {
        let ((step, environment), state) = (place(row), normals(INPUTS, &mut rng));
        Final { step, environment, state, ..Final::default() }
    };
    let finals = finals.map(&mut last).collect();
    let terminated = vec![false; rows];
    let environments = ENVIRONMENTS;
    Batch { steps, environments, state, truncated, terminated, finals, ..Batch::default() }
}

fn values(critic: &Critic, batch: &Batch) -> Values {
    critic.values(batch).unwrap()
}

/// A critic whose memory is that of an earlier rollout.
fn with_memory() -> Critic {
    let mut critic = critic(&config());
    let before = values(&critic, &rollout(0, STEPS, &[]));
    critic.carry(&before);
    critic
}

fn carried(critic: &Critic) -> &[f32] {
    &critic.memory.as_ref().unwrap().carried
}

fn arrays(critic: &mut Critic) -> NamedArrays {
    saved("", |visitor| critic.visit(visitor)).unwrap()
}

fn restore(critic: &mut Critic, arrays: &NamedArrays) -> Result<(), MarlError> {
    restored(arrays, |visitor| critic.visit(visitor)).map(drop)
}

/// The values of one row, `[V]`.
fn of_row(values: &Values, row: usize) -> &[f64] {
    &values.normalized[row * VALUES..(row + 1) * VALUES]
}

#[test]
fn values_after_an_episodes_end_do_not_depend_on_what_was_before() {
    let critic = with_memory();
    let batch = rollout(1, STEPS, &ENDS);
    let mut changed = batch.clone();
    for row in 0..ENVIRONMENTS {
        changed.state[row * INPUTS] += 1.0;
    }
    let (old, new) = (values(&critic, &batch), values(&critic, &changed));
    for row in 0..batch.rows() {
        let (step, environment) = (row / ENVIRONMENTS, row % ENVIRONMENTS);
        let end = [1, 2, 5][environment];
        assert_eq!(of_row(&old, row) == of_row(&new, row), step > end, "row {row}");
    }
}

#[test]
fn states_are_carried_to_the_next_rollout_except_across_an_end() {
    let mut critic = with_memory();
    let ended = values(&critic, &rollout(1, STEPS, &ENDS));
    critic.carry(&ended);
    let zero: Vec<bool> =
        carried(&critic).chunks_exact(WIDTH).map(|state| state.iter().all(|&x| x == 0.0)).collect();
    assert_eq!(zero, [false, false, true]);
}

#[test]
fn two_rollouts_have_the_values_of_one_of_twice_the_length() {
    let mut critic = with_memory();
    let whole = rollout(1, 2 * STEPS, &ENDS);
    let expected = values(&critic, &whole);
    let half = STEPS * ENVIRONMENTS;
    let mut first = rollout(1, STEPS, &ENDS);
    first.state = whole.state[..half * INPUTS].to_vec();
    let mut second = rollout(1, STEPS, &[]);
    second.state = whole.state[half * INPUTS..].to_vec();
    let found = values(&critic, &first);
    critic.carry(&found);
    let both = [found.normalized, values(&critic, &second).normalized].concat();
    assert_eq!(both, expected.normalized);
}

#[test]
fn a_truncated_episode_is_bootstrapped_with_the_memory_of_its_last_step() {
    let critic = with_memory();
    let whole = values(&critic, &rollout(1, STEPS, &[]));
    let mut cut = rollout(1, STEPS, &[(2, 1)]);
    let next = 3 * ENVIRONMENTS + 1;
    cut.finals[0].state = cut.state[next * INPUTS..(next + 1) * INPUTS].to_vec();
    let found = values(&critic, &cut);
    for head in 0..VALUES {
        let row = next - ENVIRONMENTS;
        assert_eq!(found.next[head][row], whole.now[head][next]);
        assert_ne!(found.now[head][next], whole.now[head][next]);
    }
}

/// Values of all chunks as the fit computes them, in the order of rows.
fn by_chunks(critic: &Critic, batch: &Batch, values: &Values) -> Vec<f64> {
    let (layout, weights) = (values.layout, critic.layers.weights().unwrap());
    let mut found = vec![0.0; values.normalized.len()];
    for chunk in 0..layout.chunks {
        let rows = layout.sources(&[chunk]);
        let states = rows.iter().flat_map(|&row| &batch.state[row * INPUTS..(row + 1) * INPUTS]);
        let unrolled = values.unrolled.as_ref().unwrap();
        let start = unrolled.start(layout, &[chunk]).unwrap();
        let own = critic.forward(&weights, states.copied().collect(), Some(&start)).unwrap();
        for (row, own) in rows.iter().zip(numbers(&own).unwrap().chunks_exact(VALUES)) {
            found[row * VALUES..(row + 1) * VALUES].copy_from_slice(own);
        }
    }
    found
}

#[test]
fn chunks_of_an_unchanged_critic_have_the_values_of_the_whole_rollout_bit_for_bit() {
    let critic = with_memory();
    let batch = rollout(1, STEPS, &ENDS);
    let values = values(&critic, &batch);
    assert_eq!(values.layout.chunks, STEPS / CHUNK * ENVIRONMENTS);
    assert_eq!(by_chunks(&critic, &batch, &values), values.normalized);
}

/// Rows of a stored matrix or vector `[out]`, `[out][in]`.
fn stored(arrays: &NamedArrays, name: &str) -> Vec<Vec<f64>> {
    match &arrays[&format!("weights/critic.{name}")] {
        Array::F32 { shape, data } => {
            let width = if shape.len() == 2 { shape[1] } else { 1 };
            let data: Vec<f64> = data.iter().map(|&x| f64::from(x)).collect();
            data.chunks_exact(width).map(<[f64]>::to_vec).collect()
        }
        _ => panic!("{name} is not f32"),
    }
}

fn affine(arrays: &NamedArrays, weight: &str, bias: &str, x: &[f64]) -> Vec<f64> {
    let row = |(row, bias): (Vec<f64>, Vec<f64>)| {
        bias[0] + row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>()
    };
    stored(arrays, weight).into_iter().zip(stored(arrays, bias)).map(row).collect()
}

/// Layer norms have their initial weights of 1 and biases of 0.
fn normalised(x: &[f64]) -> Vec<f64> {
    let count = x.len() as f64;
    let mean = x.iter().sum::<f64>() / count;
    let variance = x.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count;
    x.iter().map(|x| (x - mean) / libm::sqrt(variance + 1e-5)).collect()
}

#[test]
fn one_step_is_a_gru_step_between_the_layers_and_the_values() {
    let mut critic = with_memory();
    critic.parameters.vars()[0].set(&shifted(&critic, 0.1)).unwrap();
    let norms = ["norm", "layers.0.norm", "gru_norm"];
    reset_norms(&mut critic, &norms);
    let (batch, start) = (rollout(1, STEPS, &[]), carried(&critic)[..WIDTH].to_vec());
    let arrays = arrays(&mut critic);
    let x: Vec<f64> = batch.state[..INPUTS].iter().map(|&x| f64::from(x)).collect();
    let h: Vec<f64> = start.iter().map(|&h| f64::from(h)).collect();
    let y = affine(&arrays, "layers.0.linear.weight", "layers.0.linear.bias", &normalised(&x));
    let y = normalised(&y.into_iter().map(|y| y.max(0.0)).collect::<Vec<_>>());
    let input = affine(&arrays, "gru.weight_ih", "gru.bias_ih", &y);
    let recurrent = affine(&arrays, "gru.weight_hh", "gru.bias_hh", &h);
    let sigmoid = |x: f64| 1.0 / (1.0 + libm::exp(-x));
    let unit = |unit: usize| {
        let r = sigmoid(input[unit] + recurrent[unit]);
        let z = sigmoid(input[WIDTH + unit] + recurrent[WIDTH + unit]);
        let n = libm::tanh(input[2 * WIDTH + unit] + r * recurrent[2 * WIDTH + unit]);
        (1.0 - z) * n + z * h[unit]
    };
    let after: Vec<f64> = (0..WIDTH).map(unit).collect();
    let expected = affine(&arrays, "value.weight", "value.bias", &normalised(&after));
    let found = values(&critic, &batch);
    for (found, expected) in of_row(&found, 0).iter().zip(expected) {
        // A sum of some ten products of single precision.
        assert!((found - expected).abs() < 2e-6, "{found} {expected}");
    }
}

/// All parameters plus random numbers of deviation `by`, so that no bias is 0.
fn shifted(critic: &Critic, by: f64) -> Tensor {
    let var = critic.parameters.vars()[0].as_tensor();
    let mut rng = generator(RunSeed(8), Draw::of(Purpose::Probe));
    let moves = normals(var.elem_count(), &mut rng);
    let moves = Tensor::from_vec(moves, var.shape(), &Device::Cpu).unwrap();
    (var + (moves * by).unwrap()).unwrap()
}

fn reset_norms(critic: &mut Critic, names: &[&str]) {
    let mut arrays = arrays(critic);
    for name in names {
        for (part, value) in [("weight", 1.0), ("bias", 0.0)] {
            let array = arrays.get_mut(&format!("weights/critic.{name}.{part}")).unwrap();
            let Array::F32 { data, .. } = array else { panic!("{name} is not f32") };
            data.fill(value);
        }
    }
    restore(critic, &arrays).unwrap();
}

/// Loss and gradient on some chunks.
fn loss(critic: &Critic, batch: &Batch, values: &Values, target: &[f64]) -> (f64, Gradients) {
    let data = FitData { rows: &batch.state, values, target };
    let weights = critic.layers.weights().unwrap();
    critic.gradient(&weights, data, &[0, 4, 3], 6).unwrap()
}

#[test]
fn the_gradient_matches_finite_differences() {
    let critic = with_memory();
    let batch = rollout(1, STEPS, &ENDS);
    let values = values(&critic, &batch);
    let target: Vec<f64> = (0..values.normalized.len()).map(|at| (at % 7) as f64 - 3.0).collect();
    let var = &critic.parameters.vars()[0];
    var.set(&shifted(&critic, 0.01)).unwrap();
    let (_, Gradients(gradients)) = loss(&critic, &batch, &values, &target);
    let gradient = &gradients[0];
    let loss = || loss(&critic, &batch, &values, &target).0;
    let used = meets_finite_differences(&loss, (var, gradient), 0..gradient.len(), (1e-3, 1e-4));
    assert!(2 * used > gradient.len(), "{used} of {} have a slope", gradient.len());
}

#[test]
fn a_state_that_is_not_finite_is_forgotten_after_the_rollout() {
    let mut critic = critic(&config());
    let mut batch = rollout(0, STEPS, &[]);
    batch.state[..INPUTS].fill(f32::MAX);
    let broken = values(&critic, &batch);
    assert!(!broken.now[0].iter().all(|value| value.is_finite()), "{:?}", broken.now[0]);
    critic.carry(&broken);
    let next = values(&critic, &rollout(1, STEPS, &[]));
    assert!(next.now.iter().flatten().all(|value| value.is_finite()));
}

#[test]
fn states_of_another_number_of_environments_or_units_are_refused() {
    let mut critic = with_memory();
    let mut arrays = arrays(&mut critic);
    let name = "memory/critic.hidden".to_owned();
    let two = Array::F32 { shape: vec![2, WIDTH], data: vec![0.5; 2 * WIDTH] };
    arrays.insert(name.clone(), two);
    restore(&mut critic, &arrays).unwrap();
    let batch = rollout(1, STEPS, &[]);
    let error = critic.values(&batch).unwrap_err().to_string();
    assert_eq!(error, "batch: 3 environments; the critic has states of 2");
    let wide = Array::F32 { shape: vec![3, 4], data: vec![0.5; 12] };
    let of_four = "stored state: memory/critic.hidden has shape [3, 4] F32, expected [any, 5] F32";
    let lacking = "stored state: memory/critic.hidden is missing";
    for (wrong, expected) in [(Some(wide), of_four), (None, lacking)] {
        arrays.remove(&name);
        arrays.extend(wrong.map(|array| (name.clone(), array)));
        let error = restore(&mut critic, &arrays).unwrap_err().to_string();
        assert_eq!(error, expected);
    }
}

/// Episodes of `CHUNK` steps whose first state has a cue, which is also every step's return; later states are noise.
fn cued(number: u32) -> (Batch, Vec<f64>) {
    let last = |step: usize| step % CHUNK == CHUNK - 1;
    let ends: Vec<(usize, usize)> = (0..STEPS)
        .filter(|&step| last(step))
        .flat_map(|step| (0..ENVIRONMENTS).map(move |environment| (step, environment)))
        .collect();
    let mut batch = rollout(number, STEPS, &ends);
    let mut returns = Vec::new();
    for row in 0..batch.rows() {
        let (step, environment) = (row / ENVIRONMENTS, row % ENVIRONMENTS);
        let first = (step - step % CHUNK) * ENVIRONMENTS + environment;
        batch.state[row * INPUTS + 1] = f32::from(u8::from(row == first));
        if row != first {
            batch.state[row * INPUTS] = 0.0;
        }
        returns.push(f64::from(batch.state[first * INPUTS]));
    }
    (batch, returns)
}

/// Mean explained variance of the last rollouts of a critic that is fitted on many.
fn explained(core: CriticCore) -> f64 {
    let (input_norm, state_norm) = (policy::InputNorm::None, StateNorm::Running);
    let usual = CriticConfig { core, input_norm, state_norm, ..config() };
    let (width, learning_rate, epochs, normalizer_beta) = (16, 1e-2, 5, 0.9);
    let config = CriticConfig { width, learning_rate, epochs, normalizer_beta, ..usual };
    let mut critic = critic(&config);
    let mut shares = Vec::new();
    for number in 0..200 {
        let (batch, returns) = cued(number);
        let values = values(&critic, &batch);
        critic.carry(&values);
        let returns = vec![returns; VALUES];
        let figures = critic.fit(&batch, &values, &returns, u64::from(number)).unwrap();
        shares.push(figures.explained_variance);
    }
    shares[150..].iter().sum::<f64>() / 50.0
}

#[test]
fn only_a_recurrent_critic_explains_returns_that_need_memory() {
    let (gru, mlp) = (explained(CriticCore::Gru), explained(CriticCore::Mlp));
    // A cue is visible in one step of three.
    assert!(gru > 0.8 && mlp < 0.45, "gru {gru}, mlp {mlp}");
}
