//! Acting agrees with training, and a row's bits do not depend on the other rows.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use candle_core::{Device, Tensor};
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use policy::{
    ActorNetwork, ActorPolicy, CoreKind, Distribution, Head, PolicyConfig, Scratch, SequenceInput,
    probe,
};

const OBSERVATION: usize = 23;
const CHOICES: Head = Head::Categorical { choices: 5 };

fn network_of(core: CoreKind, head: Head, seed: u64) -> ActorNetwork {
    let config = PolicyConfig {
        encoder: 32,
        hidden: 24,
        width: 40,
        layers: 2,
        backpropagation_steps: 5,
        ..probe::config(core)
    };
    let mut rng = generator(RunSeed(seed), Draw::of(Purpose::Initialisation));
    let action = if head == Head::Gaussian { 2 } else { 1 };
    ActorNetwork::new(&config, OBSERVATION, action, head, &mut rng).unwrap()
}

/// Both cores, each with continuous actions and with choices.
fn networks() -> Vec<ActorNetwork> {
    let cores = [CoreKind::Gru, CoreKind::Mlp];
    let both = |core| [Head::Gaussian, CHOICES].map(|head| network_of(core, head, 11));
    cores.into_iter().flat_map(both).collect()
}

fn normals(seed: u64, count: usize) -> Vec<f32> {
    let mut rng = generator(RunSeed(seed), Draw::of(Purpose::Probe));
    (0..count).map(|_| standard_normal(&mut rng)).collect()
}

fn tensor(data: &[f32], shape: (usize, usize)) -> Tensor {
    Tensor::from_slice(data, shape, &Device::Cpu).unwrap()
}

/// Sequences whose states start at 1/4.
fn input(network: &ActorNetwork, observation: &[f32], mask: &[f32], count: usize) -> SequenceInput {
    let width = network.hidden_size().max(1);
    SequenceInput {
        observation: tensor(observation, (mask.len(), OBSERVATION)),
        hidden: tensor(&vec![0.25; count * width], (count, width)),
        mask: tensor(mask, (mask.len() / count, count)),
    }
}

/// Means and standard deviations, or logits.
fn trained(network: &ActorNetwork, input: &SequenceInput) -> (Tensor, Option<Tensor>) {
    match network.distribution(&network.weights().unwrap(), input).unwrap() {
        Distribution::Gaussian(gaussian) => (gaussian.mean, Some(gaussian.sigma)),
        Distribution::Categorical(categorical) => (categorical.logits, None),
    }
}

/// Steps `policy` through `[T, B, obs]`, resetting where the mask is 0: outputs `[T, B, out]`.
fn act(policy: &ActorPolicy, observation: &[f32], mask: &[f32], sequences: usize) -> Vec<f32> {
    let (hidden_size, width) = (policy.hidden_size(), policy.output_size());
    let mut hidden = vec![0.25; sequences * hidden_size];
    let mut outputs = vec![0.0; mask.len() * width];
    let mut scratch = Scratch::default();
    let steps = mask.chunks_exact(sequences).zip(observation.chunks_exact(sequences * OBSERVATION));
    for ((mask, observation), output) in steps.zip(outputs.chunks_exact_mut(sequences * width)) {
        for (row, &keep) in mask.iter().enumerate() {
            let state = &mut hidden[row * hidden_size..(row + 1) * hidden_size];
            state.iter_mut().for_each(|h| *h *= keep);
        }
        policy.forward(sequences, observation, &mut hidden, output, &mut scratch);
    }
    outputs
}

#[test]
fn acting_step_by_step_gives_the_bits_of_the_training_network() {
    let (steps, sequences) = (20, 6);
    let rows = steps * sequences;
    let observation = normals(1, rows * OBSERVATION);
    let mut mask = vec![1.0; rows];
    (mask[8], mask[50], mask[51]) = (0.0, 0.0, 0.0);
    for network in networks() {
        let policy = network.policy().unwrap();
        let (output, sigma) = trained(&network, &input(&network, &observation, &mask, sequences));
        let sigma = sigma.map_or(Vec::new(), |sigma| sigma.to_vec1::<f32>().unwrap());
        assert_eq!(sigma, policy.sigma());
        let output = output.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(act(&policy, &observation, &mask, sequences), output, "{:?}", policy.spec());
    }
}

#[test]
fn a_row_has_the_same_bits_and_the_same_action_in_every_batch() {
    for network in networks() {
        let policy = network.policy().unwrap();
        let (hidden_size, width) = (policy.hidden_size(), policy.output_size());
        let (observation, state) = (normals(3, 64 * OBSERVATION), normals(4, 64 * hidden_size));
        let run = |from: usize| {
            let mut hidden = state[from * hidden_size..].to_vec();
            let mut output = vec![0.0; (64 - from) * width];
            let seen = &observation[from * OBSERVATION..];
            policy.forward(64 - from, seen, &mut hidden, &mut output, &mut Scratch::default());
            let draw = |(row, output): (usize, &[f32])| {
                let key = Draw::of(Purpose::Action).environment((from + row) as u32);
                let mut action = vec![0.0; policy.action_size()];
                policy.draw(output, &mut generator(RunSeed(4), key), &mut action);
                action
            };
            let actions = output.chunks_exact(width).enumerate().map(draw).collect::<Vec<_>>();
            (output, hidden, actions)
        };
        let (output, hidden, actions) = run(0);
        assert!(actions.iter().any(|action| *action != actions[0]));
        for from in 1..64 {
            let part = run(from);
            assert_eq!(part.0, output[from * width..], "{} rows", 64 - from);
            assert_eq!(part.1, hidden[from * hidden_size..]);
            assert_eq!(part.2, actions[from..]);
        }
    }
}
