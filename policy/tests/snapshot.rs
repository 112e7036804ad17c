//! Snapshots survive a round trip, and invalid bytes are rejected.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::collections::BTreeMap;

use policy::arrays::{Array, NamedArrays, from_safetensors, to_safetensors};
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::snapshot::{Repeat, repeats};
use policy::{
    ActorNetwork, ActorPolicy, CoreKind, Head, PolicyConfig, PolicySnapshot, Scratch, probe,
};

fn config(core: CoreKind) -> PolicyConfig {
    PolicyConfig { encoder: 4, hidden: 3, width: 4, ..probe::config(core) }
}

/// An agent of 5 observation features.
fn agent(core: CoreKind, action: usize, head: Head) -> ActorPolicy {
    let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
    ActorNetwork::new(&config(core), 5, action, head, &mut rng).unwrap().policy().unwrap()
}

const SQUASHED: Head = Head::TanhGaussian { low: -1.0, high: 3.0, noise: None };

/// An agent of 5 observation features and 2 action values, whose parameters are multiples of 0.01.
fn squashed() -> ActorPolicy {
    let parameters = (0..44).map(|i| 0.01 * i as f32).collect::<Vec<_>>();
    ActorPolicy::without_norms(&config(CoreKind::Mlp), (5, 2), SQUASHED, (&parameters, None))
        .unwrap()
}

fn snapshot() -> PolicySnapshot {
    let agent = |(core, action)| agent(core, action, Head::Gaussian);
    PolicySnapshot { agents: [(CoreKind::Gru, 1), (CoreKind::Mlp, 2)].map(agent).to_vec() }
}

/// Outputs and the next recurrent state for a fixed observation.
fn run(policy: &ActorPolicy) -> (Vec<f32>, Vec<f32>) {
    let mut hidden = vec![0.1; policy.hidden_size()];
    let mut output = vec![0.0; policy.output_size()];
    policy.forward(1, &[0.3; 5], &mut hidden, &mut output, &mut Scratch::default());
    (output, hidden)
}

fn refusal(arrays: &NamedArrays, metadata: &BTreeMap<String, String>) -> String {
    let bytes = to_safetensors(arrays, metadata).unwrap();
    PolicySnapshot::from_bytes(&bytes).unwrap_err().to_string()
}

#[test]
fn a_snapshot_says_how_to_act_after_a_round_trip_and_equal_policies_have_equal_bytes() {
    let deterministic = Head::Deterministic { noise_sigma: 0.1, low: -1.0, high: 3.0 };
    let exploring = agent(CoreKind::Mlp, 2, deterministic);
    let choosing = agent(CoreKind::Gru, 1, Head::Categorical { choices: 5 });
    let (squashed, warming_up) = (squashed(), squashed().uniform());
    let mut original = snapshot();
    original.agents.extend([exploring.clone(), exploring.uniform(), choosing]);
    original.agents.extend([squashed, warming_up]);
    let bytes = original.to_bytes().unwrap();
    let back = PolicySnapshot::from_bytes(&bytes).unwrap();
    assert_eq!(back.to_bytes().unwrap(), bytes);
    let heads = [
        Head::Gaussian,
        Head::Gaussian,
        deterministic,
        Head::Uniform { low: -1.0, high: 3.0 },
        Head::Categorical { choices: 5 },
        SQUASHED,
        Head::Uniform { low: -1.0, high: 3.0 },
    ];
    for ((one, two), head) in original.agents.iter().zip(&back.agents).zip(heads) {
        assert_eq!((two.spec().head(), run(two), two.sigma()), (head, run(one), one.sigma()));
    }
    // A deterministic actor has no deviations to learn, and one of choices has none.
    assert!(!back.agents[2].arrays().contains_key("head.log_std"));
    assert_eq!(back.agents[2].sigma(), [0.1, 0.1]);
    assert_eq!(run(&back.agents[2]), run(&back.agents[3]));
    assert_eq!((back.agents[4].action_size(), back.agents[4].sigma().len()), (1, 0));
}

#[test]
fn a_tanh_gaussian_policy_without_norms_has_the_layers_given_and_keeps_its_mode_in_the_warm_up() {
    let policy = squashed();
    // Every weight and bias is 0.01 i: four units relu(0.3 * 5 w + b), then two means and two deviations.
    let number = |i: usize| 0.01 * i as f32;
    let unit = |u: usize| 0.3 * (0..5).map(|x| number(5 * u + x)).sum::<f32>() + number(20 + u);
    let output =
        |o: usize| (0..4).map(|u| number(24 + 4 * o + u) * unit(u)).sum::<f32>() + number(40 + o);
    let found = run(&policy).0;
    assert!(found.iter().enumerate().all(|(o, x)| (x - output(o)).abs() < 1e-3), "{found:?}");
    let mode = |policy: &ActorPolicy| {
        let mut action = [0.0; 2];
        policy.mode(&run(policy).0, &mut action);
        action
    };
    let (own, warming_up) = (mode(&policy), mode(&squashed().uniform()));
    assert!(own.iter().zip(warming_up).all(|(own, other)| (own - other).abs() < 1e-5), "{own:?}");
    let few =
        ActorPolicy::without_norms(&config(CoreKind::Mlp), (5, 2), SQUASHED, (&[0.0; 43], None));
    assert!(few.unwrap_err().to_string().contains("43 parameters, expected 44"));
}

#[test]
fn a_later_agent_with_the_first_ones_network_repeats_its_bytes() {
    let mut snapshot = snapshot();
    assert_eq!(repeats(&snapshot.to_bytes().unwrap()).unwrap(), []);
    let first = snapshot.agents[0].clone();
    let numbers = first.arrays().values().map(|array| array.shape().iter().product::<usize>());
    let size = 4 * numbers.sum::<usize>();
    snapshot.agents.push(first);
    let bytes = snapshot.to_bytes().unwrap();
    let found = repeats(&bytes).unwrap();
    let [Repeat { at, of, length }] = found[..] else { panic!("one repeat, not {found:?}") };
    assert_eq!((length, at + length), (size, bytes.len()));
    assert_eq!(bytes[at..], bytes[of..of + length]);
}

#[test]
fn a_gaussian_snapshot_names_no_head() {
    let bytes = snapshot().to_bytes().unwrap();
    assert!(!String::from_utf8_lossy(&bytes).contains("gaussian"));
}

#[test]
fn an_array_that_is_missing_extra_reshaped_or_not_finite_is_named() {
    let (arrays, metadata) = from_safetensors(&snapshot().to_bytes().unwrap()).unwrap();
    let bias = "agent_0.head.bias";
    let changes: [(Option<Array>, &str, &str); 4] = [
        (None, bias, "head.bias is missing"),
        (Some(Array::F32 { shape: vec![1], data: vec![f32::NAN] }), bias, "head.bias has a value"),
        (Some(Array::F32 { shape: vec![2], data: vec![0.0; 2] }), bias, "head.bias has shape [2]"),
        (
            Some(Array::U8 { shape: vec![1], data: vec![0] }),
            "agent_7.x",
            "agent_7.x belongs to no agent",
        ),
    ];
    for (change, name, expected) in changes {
        let mut changed = arrays.clone();
        changed.remove(name);
        changed.extend(change.map(|array| (name.to_owned(), array)));
        let error = refusal(&changed, &metadata);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn sizes_with_which_no_network_can_act_are_refused_by_name() {
    for (core, name, size) in [
        ("gru", "observation", 0),
        ("gru", "observation", u64::MAX),
        ("gru", "encoder", u64::MAX),
        ("gru", "action", 0),
        ("gru", "hidden", 0),
        // Three times as many gates do not fit 64 bits.
        ("gru", "hidden", u64::MAX / 2),
        ("mlp", "width", 0),
        ("mlp", "layers", 0),
    ] {
        let mut spec = serde_json::json!({
            "core": core, "observation": 1, "action": 1, "encoder": 1, "hidden": 1, "width": 1,
            "layers": 1, "chunk_steps": 1, "sigma_scale": 0.5
        });
        spec[name] = size.into();
        let metadata = BTreeMap::from([("s2mia.policy".to_owned(), format!("[{spec}]"))]);
        let error = refusal(&NamedArrays::new(), &metadata);
        assert!(error.contains(&format!("{name} is {size}")), "{error}");
    }
}

#[test]
fn bytes_that_are_no_snapshot_are_refused_without_a_panic() {
    let bytes = snapshot().to_bytes().unwrap();
    for length in (0..bytes.len()).step_by(7) {
        assert!(PolicySnapshot::from_bytes(&bytes[..length]).is_err());
    }
    for index in 0..bytes.len().min(4000) {
        let mut flipped = bytes.clone();
        flipped[index] ^= 0x21;
        let _ = PolicySnapshot::from_bytes(&flipped);
    }
    let mut huge = bytes;
    huge[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(PolicySnapshot::from_bytes(&huge).is_err());
}

#[test]
fn sigma_is_raised_to_a_floor_and_not_lowered() {
    let policy = agent(CoreKind::Mlp, 2, Head::Gaussian);
    let initial = policy.sigma()[0];
    for (floor, expected) in [(0.5 * initial, initial), (1.1 * initial, 1.1 * initial)] {
        let raised = policy.with_sigma_from(floor).unwrap();
        for sigma in raised.sigma() {
            assert!((sigma - expected).abs() < 1e-6, "{floor}: {sigma}");
        }
    }
    let squashed = squashed();
    assert_eq!(squashed.with_sigma_from(0.4).unwrap().arrays(), squashed.arrays());
}
