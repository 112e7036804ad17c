//! Acting agrees with training, and a row's bits do not depend on the other rows.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use candle_core::{DType, Device, Tensor};
use policy::ops::Backward;
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use policy::{
    ActorNetwork, ActorPolicy, CoreKind, Distribution, Gaussian, Head, InputNorm, PolicyConfig,
    Scratch, SequenceInput, gaussian,
};

const OBSERVATION: usize = 23;
const ACTION: usize = 2;

fn config(core: CoreKind) -> PolicyConfig {
    PolicyConfig {
        core,
        input_norm: InputNorm::LayerNorm,
        encoder: 32,
        hidden: 24,
        width: 40,
        layers: 2,
        backpropagation_steps: 5,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 1.0,
    }
}

fn network(core: CoreKind) -> ActorNetwork {
    let mut rng = generator(RunSeed(11), Draw::of(Purpose::Initialisation));
    ActorNetwork::new(&config(core), OBSERVATION, ACTION, Head::Gaussian, &mut rng).unwrap()
}

fn normals(seed: u64, count: usize) -> Vec<f32> {
    let mut rng = generator(RunSeed(seed), Draw::of(Purpose::Probe));
    (0..count).map(|_| standard_normal(&mut rng)).collect()
}

/// The distribution of a network with a Gaussian head.
fn gaussian_of(network: &ActorNetwork, input: &SequenceInput) -> Gaussian {
    match network.distribution(&network.weights().unwrap(), input).unwrap() {
        Distribution::Gaussian(gaussian) => gaussian,
        Distribution::Categorical(_) => panic!("a categorical head"),
    }
}

/// Steps `policy` through `[T, B, obs]`, resetting where the mask is 0: means `[T, B, act]`.
fn act(policy: &ActorPolicy, observation: &[f32], mask: &[f32], sequences: usize) -> Vec<f32> {
    let hidden_size = policy.hidden_size();
    let mut hidden = vec![0.25; sequences * hidden_size];
    let mut means = vec![0.0; observation.len() / OBSERVATION * ACTION];
    let mut scratch = Scratch::default();
    let steps = mask.chunks_exact(sequences).zip(observation.chunks_exact(sequences * OBSERVATION));
    for ((mask, observation), mean) in steps.zip(means.chunks_exact_mut(sequences * ACTION)) {
        for (row, &keep) in mask.iter().enumerate() {
            let state = &mut hidden[row * hidden_size..(row + 1) * hidden_size];
            state.iter_mut().for_each(|h| *h *= keep);
        }
        policy.forward(sequences, observation, &mut hidden, mean, &mut scratch);
    }
    means
}

#[test]
fn acting_step_by_step_gives_the_bits_of_the_training_networks_log_probs() {
    let (steps, sequences) = (20, 6);
    let rows = steps * sequences;
    let observation = normals(1, rows * OBSERVATION);
    let mut mask = vec![1.0; rows];
    (mask[8], mask[50], mask[51]) = (0.0, 0.0, 0.0);
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let network = network(core);
        let policy = network.policy().unwrap();
        let hidden =
            Tensor::full(0.25_f32, (sequences, network.hidden_size().max(1)), &Device::Cpu)
                .unwrap();
        let tensor = |data: &[f32], shape: (usize, usize)| {
            Tensor::from_slice(data, shape, &Device::Cpu).unwrap()
        };
        let input = SequenceInput {
            observation: tensor(&observation, (rows, OBSERVATION)),
            hidden,
            mask: tensor(&mask, (steps, sequences)),
        };
        let trained = gaussian_of(&network, &input);
        let (mean, sigma) = (
            trained.mean.flatten_all().unwrap().to_vec1::<f32>().unwrap(),
            trained.sigma.to_vec1::<f32>().unwrap(),
        );
        assert_eq!(sigma, policy.sigma());
        let acted = act(&policy, &observation, &mask, sequences);
        let actions = normals(2, rows * ACTION);
        for row in 0..rows {
            let of = row * ACTION..(row + 1) * ACTION;
            let one = gaussian::log_prob(&acted[of.clone()], &sigma, &actions[of.clone()]);
            let two = gaussian::log_prob(&mean[of.clone()], &sigma, &actions[of]);
            assert_eq!(one, two, "{core:?} row {row}");
        }
    }
}

#[test]
fn a_row_has_the_same_bits_in_every_batch() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let policy = network(core).policy().unwrap();
        let hidden_size = policy.hidden_size();
        let (observation, state) = (normals(3, 64 * OBSERVATION), normals(4, 64 * hidden_size));
        let run = |from: usize, to: usize| {
            let mut hidden = state[from * hidden_size..to * hidden_size].to_vec();
            let mut mean = vec![0.0; (to - from) * ACTION];
            let rows = &observation[from * OBSERVATION..to * OBSERVATION];
            policy.forward(to - from, rows, &mut hidden, &mut mean, &mut Scratch::default());
            (mean, hidden)
        };
        let (mean, hidden) = run(0, 64);
        for rows in 1..=64 {
            let (part, part_hidden) = run(64 - rows, 64);
            assert_eq!(part, mean[(64 - rows) * ACTION..], "{core:?}: {rows} rows");
            assert_eq!(part_hidden, hidden[(64 - rows) * hidden_size..]);
        }
    }
}

#[test]
fn every_parameter_has_a_gradient() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let network = network(core);
        let input = SequenceInput {
            observation: Tensor::from_vec(
                normals(5, 12 * OBSERVATION),
                (12, OBSERVATION),
                &Device::Cpu,
            )
            .unwrap(),
            hidden: Tensor::zeros((3, network.hidden_size().max(1)), DType::F32, &Device::Cpu)
                .unwrap(),
            mask: Tensor::ones((4, 3), DType::F32, &Device::Cpu).unwrap(),
        };
        let head = gaussian_of(&network, &input);
        let loss = (head.mean.sqr().unwrap().sum_all().unwrap()
            + head.sigma.log().unwrap().sum_all().unwrap())
        .unwrap();
        let gradients = Backward::from(&loss).unwrap();
        for (index, var) in network.parameters().vars().iter().enumerate() {
            let name = network.parameters().name_of(index);
            assert!(gradients.by(var).unwrap().is_some(), "{name} has no gradient");
        }
    }
}

#[test]
fn projection_holds_sigma_at_its_floor_and_leaves_the_rest_alone() {
    let network = network(CoreKind::Gru);
    let before = network.policy().unwrap().sigma().to_vec();
    network.project().unwrap();
    assert_eq!(network.policy().unwrap().sigma(), before);
    let spans = network.parameters().spans();
    let span = spans.iter().find(|span| span.name == "head.log_std").unwrap();
    let log_std = &network.parameters().vars()[span.var];
    log_std.set(&Tensor::new(&[-9.0_f32, 0.0], &Device::Cpu).unwrap()).unwrap();
    network.project().unwrap();
    let sigma = network.policy().unwrap().sigma().to_vec();
    assert!((sigma[0] - 0.05).abs() < 1e-6 && (sigma[1] - 0.25).abs() < 1e-6, "{sigma:?}");
}

#[test]
fn the_same_draw_gives_the_same_network_and_another_draw_another() {
    let bits = |seed: u64| {
        let mut rng = generator(RunSeed(seed), Draw::of(Purpose::Initialisation));
        let network = ActorNetwork::new(
            &config(CoreKind::Gru),
            OBSERVATION,
            ACTION,
            Head::Gaussian,
            &mut rng,
        )
        .unwrap();
        policy::arrays::sha256(&network.parameters().to_arrays().unwrap())
    };
    assert_eq!(bits(1), bits(1));
    assert_ne!(bits(1), bits(2));
}
