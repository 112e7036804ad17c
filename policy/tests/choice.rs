//! A categorical head acts as it is trained, in every batch, and survives a snapshot.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use candle_core::{DType, Device, Tensor};
use policy::ops::Backward;
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use policy::{
    ActorNetwork, CoreKind, Distribution, Head, InputNorm, PolicyConfig, PolicySnapshot, Scratch,
    SequenceInput, categorical,
};

const OBSERVATION: usize = 9;
const CHOICES: usize = 5;

fn network(core: CoreKind) -> ActorNetwork {
    let config = PolicyConfig {
        core,
        input_norm: InputNorm::LayerNorm,
        encoder: 16,
        hidden: 12,
        width: 16,
        layers: 2,
        backpropagation_steps: 5,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 1.0,
    };
    let mut rng = generator(RunSeed(11), Draw::of(Purpose::Initialisation));
    let head = Head::Categorical { choices: CHOICES };
    ActorNetwork::new(&config, OBSERVATION, 1, head, &mut rng).unwrap()
}

fn normals(seed: u64, count: usize) -> Vec<f32> {
    let mut rng = generator(RunSeed(seed), Draw::of(Purpose::Probe));
    (0..count).map(|_| 2.0 * standard_normal(&mut rng)).collect()
}

fn logits(network: &ActorNetwork, observation: &[f32], rows: usize) -> Tensor {
    let input = SequenceInput {
        observation: Tensor::from_slice(observation, (rows, OBSERVATION), &Device::Cpu).unwrap(),
        hidden: Tensor::zeros((rows, network.hidden_size().max(1)), DType::F32, &Device::Cpu)
            .unwrap(),
        mask: Tensor::ones((1, rows), DType::F32, &Device::Cpu).unwrap(),
    };
    match network.distribution(&network.weights().unwrap(), &input).unwrap() {
        Distribution::Categorical(categorical) => categorical.logits,
        Distribution::Gaussian(_) => panic!("a Gaussian head"),
    }
}

#[test]
fn acting_gives_the_log_probs_of_the_training_network() {
    let rows = 200;
    let observation = normals(1, rows * OBSERVATION);
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let network = network(core);
        let policy = network.policy().unwrap();
        let trained = logits(&network, &observation, rows).to_vec2::<f32>().unwrap();
        let mut hidden = vec![0.0; rows * policy.hidden_size()];
        let mut acted = vec![0.0; rows * policy.output_size()];
        policy.forward(rows, &observation, &mut hidden, &mut acted, &mut Scratch::default());
        for (acted, trained) in acted.chunks_exact(CHOICES).zip(&trained) {
            for choice in 0..CHOICES {
                let one = policy.log_prob(acted, &[choice as f32]);
                let two = categorical::log_prob(trained, choice);
                assert!((one - two).abs() < 1e-5, "{core:?}: {one} {two}");
            }
        }
    }
}

#[test]
fn a_row_has_the_same_bits_and_the_same_choice_in_every_batch() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let policy = network(core).policy().unwrap();
        let observation = normals(3, 32 * OBSERVATION);
        let run = |from: usize| {
            let rows = 32 - from;
            let mut hidden = vec![0.1; rows * policy.hidden_size()];
            let mut output = vec![0.0; rows * CHOICES];
            let seen = &observation[from * OBSERVATION..];
            policy.forward(rows, seen, &mut hidden, &mut output, &mut Scratch::default());
            let choice = |(row, output): (usize, &[f32])| {
                let key = Draw::of(Purpose::Action).environment((from + row) as u32);
                let mut action = [0.0];
                policy.draw(output, &mut generator(RunSeed(4), key), &mut action);
                action[0]
            };
            let choices = output.chunks_exact(CHOICES).enumerate().map(choice).collect::<Vec<_>>();
            (output, choices)
        };
        let (whole, chosen) = run(0);
        for from in 1..32 {
            let (output, choices) = run(from);
            assert_eq!((&output[..], &choices[..]), (&whole[from * CHOICES..], &chosen[from..]));
        }
        assert!(chosen.iter().any(|&choice| choice != chosen[0]));
    }
}

#[test]
fn every_parameter_has_a_gradient_and_none_is_a_deviation() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let network = network(core);
        let loss = logits(&network, &normals(5, 6 * OBSERVATION), 6).sqr().unwrap();
        let gradients = Backward::from(&loss.sum_all().unwrap()).unwrap();
        for var in network.parameters().vars() {
            assert!(gradients.by(var).unwrap().is_some());
        }
        assert!(network.parameters().spans().iter().all(|span| span.name != "head.log_std"));
        network.project().unwrap();
    }
}

#[test]
fn a_snapshot_names_the_head_and_settles_on_the_likeliest_choice_after_a_round_trip() {
    let snapshot = PolicySnapshot { agents: vec![network(CoreKind::Gru).policy().unwrap()] };
    let bytes = snapshot.to_bytes().unwrap();
    let back = PolicySnapshot::from_bytes(&bytes).unwrap();
    assert_eq!(back.to_bytes().unwrap(), bytes);
    assert_eq!(back.agents[0].head(), Head::Categorical { choices: CHOICES });
    assert_eq!((back.agents[0].action_size(), back.agents[0].sigma().len()), (1, 0));
    let mut action = [9.0];
    back.agents[0].mode(&[0.1, -2.0, 0.7, 0.7, 0.2], &mut action);
    assert_eq!(action, [2.0]);
}

#[test]
fn a_gaussian_snapshot_says_nothing_of_heads_and_a_head_that_does_not_fit_is_refused() {
    let build = |action: usize, head: Head| {
        let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
        let config = PolicyConfig {
            core: CoreKind::Mlp,
            input_norm: InputNorm::LayerNorm,
            encoder: 4,
            hidden: 4,
            width: 4,
            layers: 1,
            backpropagation_steps: 1,
            sigma_scale: 0.5,
            sigma_floor: 0.05,
            head_gain: 1.0,
        };
        ActorNetwork::new(&config, 3, action, head, &mut rng)
    };
    let gaussian = build(2, Head::Gaussian).unwrap().policy().unwrap();
    let bytes = PolicySnapshot { agents: vec![gaussian] }.to_bytes().unwrap();
    assert!(!String::from_utf8_lossy(&bytes).contains("gaussian"));
    assert!(build(2, Head::Categorical { choices: 3 }).is_err());
    assert!(build(1, Head::Categorical { choices: 0 }).is_err());
}
