//! A recurrent critic's values and states. `marl/tests/references` compares them and its gradients with PyTorch's.

use policy::RunSeed;
use policy::arrays::Array;
use policy::randomness::{Draw, Purpose, generator, standard_normal};
use rand::RngCore;

use super::*;
use crate::config::{CriticConfig, CriticCore, StateNorm};
use crate::critic::Values;
use crate::data::batch::Final;
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
fn chunks_of_an_unchanged_critic_have_the_values_of_the_whole_rollout_bit_for_bit() {
    let critic = with_memory();
    let batch = rollout(1, STEPS, &ENDS);
    let values = values(&critic, &batch);
    let (layout, weights) = (values.layout, critic.layers.weights().unwrap());
    assert_eq!(layout.chunks, STEPS / CHUNK * ENVIRONMENTS);
    for chunk in 0..layout.chunks {
        let rows = layout.sources(&[chunk]);
        let states = rows.iter().flat_map(|&row| &batch.state[row * INPUTS..(row + 1) * INPUTS]);
        let start = values.unrolled.as_ref().unwrap().start(layout, &[chunk]).unwrap();
        let own = critic.forward(&weights, states.copied().collect(), Some(&start)).unwrap();
        for (row, own) in rows.iter().zip(numbers(&own).unwrap().chunks_exact(VALUES)) {
            assert_eq!(own, &values.normalized[row * VALUES..(row + 1) * VALUES], "row {row}");
        }
    }
}

#[test]
fn an_environment_that_begins_again_has_the_values_of_a_first_episode() {
    let mut critic = with_memory();
    let (next, fresh) = (rollout(1, STEPS, &[]), self::critic(&config()));
    let [before, first] = [&critic, &fresh].map(|critic| values(critic, &next).normalized);
    critic.forget(1);
    let after = values(&critic, &next).normalized;
    for (environment, expected) in [&before, &first, &before].into_iter().enumerate() {
        let rows = (environment..STEPS * ENVIRONMENTS).step_by(ENVIRONMENTS);
        for places in rows.map(|row| row * VALUES..(row + 1) * VALUES) {
            assert_eq!(after[places.clone()], expected[places], "{environment}");
        }
    }
    assert_ne!(before, first);
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
    let mut arrays = saved("", |visitor| critic.visit(visitor)).unwrap();
    let states = |shape: [usize; 2]| Array::F32 {
        shape: shape.to_vec(),
        data: vec![0.5; shape[0] * shape[1]],
    };
    arrays.insert("memory/critic.hidden".to_owned(), states([2, WIDTH]));
    restored(&arrays, |visitor| critic.visit(visitor)).unwrap();
    let error = critic.values(&rollout(1, STEPS, &[])).unwrap_err().to_string();
    assert_eq!(error, "batch: 3 environments; the critic has states of 2");
    arrays.insert("memory/critic.hidden".to_owned(), states([3, 4]));
    let error = restored(&arrays, |visitor| critic.visit(visitor)).unwrap_err().to_string();
    let expected = "memory/critic.hidden has shape [3, 4] F32, expected [any, 5] F32";
    assert_eq!(error, format!("stored state: {expected}"));
}

/// Episodes of `CHUNK` steps whose first state has a cue, which is also every step's return; the other states do not.
fn cued(number: u32) -> (Batch, Vec<f64>) {
    let is_last = |row: usize| row / ENVIRONMENTS % CHUNK == CHUNK - 1;
    let ends = (0..STEPS * ENVIRONMENTS).filter(|&row| is_last(row));
    let ends: Vec<_> = ends.map(|row| (row / ENVIRONMENTS, row % ENVIRONMENTS)).collect();
    let mut batch = rollout(number, STEPS, &ends);
    let mut returns = Vec::new();
    for row in 0..batch.rows() {
        let first = row - row / ENVIRONMENTS % CHUNK * ENVIRONMENTS;
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
