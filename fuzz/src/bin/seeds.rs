//! Writes what fuzzing begins with into `fuzz/corpus`: for each target that reads a format
//! a few inputs as the program itself makes them.

#[path = "../../../proto/tests/wire/peer.rs"]
#[expect(dead_code, reason = "no target reads requests to policies")]
mod peer;
#[path = "../../../proto/tests/wire/sample.rs"]
mod sample;

use std::fs;
use std::path::{Path, PathBuf};

use fuzz::{TASKS, recording, world};
use policy::randomness::{Draw, DrawKey, Purpose, RunSeed, generator};
use policy::{ActorNetwork, ActorPolicy, CoreKind, Head, PolicyConfig, PolicySnapshot};
use prost::Message;
use proto::wire::play_response::Answer;
use proto::wire::push_trajectory_request::Content;
use proto::{
    Digest, EnvironmentStart, EvaluationResult, Incarnation, Lease, LeaseAnswer, LeaseId,
    PROTOCOL_VERSION, PolicyVersion, ProcessId, PushHeader, Registration, RolloutWork, Start,
    Steps, View, WeightsName, Work, wire,
};

/// An input, with the byte before it by which its target chooses how to read it, if it does.
type Seed = (Option<u8>, Vec<u8>);

fn main() {
    for (target, seeds) in [
        ("chunk", messages()),
        ("config", settings()),
        ("arrays", policies()),
        ("environment_state", states()),
        ("log", vec![(Some(0), recording())]),
        ("environment_answers", answers()),
    ] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
        fs::create_dir_all(&folder).expect("the corpus can be written");
        for (index, (kind, bytes)) in seeds.into_iter().enumerate() {
            let input = kind.into_iter().chain(bytes).collect::<Vec<_>>();
            fs::write(folder.join(format!("seed_{index}")), input)
                .expect("the corpus can be written");
        }
    }
}

fn lease() -> Lease {
    let weights = WeightsName { version: PolicyVersion(3), digest: Digest([9; 32]) };
    let environments = vec![
        EnvironmentStart { environment: 0, start: Start::Fresh { episode: 0, limit: 10 } },
        EnvironmentStart { environment: 1, start: Start::Fresh { episode: 0, limit: 20 } },
    ];
    let work = Work::Rollout(RolloutWork { iteration: 3, slot: 0, environments });
    Lease { id: LeaseId(5), incarnation: Incarnation(11), weights, attempt: 0, work }
}

/// In the order in which the target distinguishes its kinds.
fn messages() -> Vec<Seed> {
    let run = sample::run();
    let push = |content, digest| PushHeader::of(&lease(), digest).to_wire(content).encode_to_vec();
    let chunks = [0, 1].map(|sequence| sample::chunk(sequence).to_wire(&run, &sample::origin()));
    let (extrinsic_return, reward_terms) = (12.5, vec![15.0, -2.5]);
    let result = EvaluationResult { episode: 0, extrinsic_return, steps: 40, reward_terms };
    let registration = Registration {
        client: "seed".to_owned(),
        build: run.build.clone(),
        protocol_version: PROTOCOL_VERSION,
        environment: sample::environment(),
        rollout_fingerprint: Some(run.rollout_fingerprint),
        process: Some(ProcessId([7; 16])),
    };
    let mut seeds = vec![
        (Some(0), push(Content::Evaluation(result.to_wire()), result.digest(3))),
        (Some(1), registration.to_wire().encode_to_vec()),
        (Some(2), LeaseAnswer::Lease(lease()).to_wire().encode_to_vec()),
        (Some(2), LeaseAnswer::Retry { wait_millis: 100 }.to_wire().encode_to_vec()),
        (Some(3), run.to_wire().encode_to_vec()),
    ];
    for (message, digest) in chunks {
        seeds.push((Some(4), message.encode_to_vec()));
        seeds.push((Some(0), push(Content::Chunk(message), digest)));
    }
    seeds
}

/// Every file of `configs`, and settings as arguments and environment variables.
fn settings() -> Vec<Seed> {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    let mut files = vec![configs.join("base.toml")];
    for folder in ["algorithms", "presets", "tasks"] {
        files.extend(files_in(&configs.join(folder)));
    }
    let read = |path: &PathBuf| fs::read(path).expect("a file of the project");
    let mut seeds = files.iter().map(|file| (Some(0), read(file))).collect::<Vec<_>>();
    seeds.push((Some(1), read(&files[0])));
    seeds.push((Some(2), b"UPDATE__GAMMA=0.9\nRUN__SEED=7\nTASK=ant-4x2\n".to_vec()));
    seeds.push((Some(3), b"halfcheetah-6x1\nalgorithm=maddpg\npolicy.core=mlp\n".to_vec()));
    seeds.push((Some(3), b"cue-2x1\ninfluence.estimator=count\nrun.env_steps=1e6".to_vec()));
    seeds
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder of the project");
    let mut files = entries.filter_map(|entry| Some(entry.ok()?.path())).collect::<Vec<_>>();
    files.sort();
    files
}

/// One policy with memory and one without.
fn policies() -> Vec<Seed> {
    let snapshot = |cores: &[CoreKind]| {
        let agents = cores.iter().map(|core| small_policy(*core, 5, 2)).collect();
        (None, PolicySnapshot { agents }.to_bytes().expect("a small policy"))
    };
    vec![
        snapshot(&[CoreKind::Gru]),
        snapshot(&[CoreKind::Mlp]),
        snapshot(&[CoreKind::Gru, CoreKind::Mlp]),
    ]
}

/// A network of a few units.
fn small_policy(core: CoreKind, observation: usize, action: usize) -> ActorPolicy {
    let config = PolicyConfig {
        encoder: 4,
        hidden: 3,
        width: 4,
        backpropagation_steps: 5,
        ..policy::probe::config(core)
    };
    let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
    let network = ActorNetwork::new(&config, observation, action, Head::Gaussian, &mut rng);
    network.and_then(|network| network.policy()).expect("a small network")
}

/// Robots at rest and at the start of an episode.
fn states() -> Vec<Seed> {
    let both = |(index, task): (u8, &str)| {
        let mut world = world(task);
        let mut states = vec![(Some(index), world.encode(0).expect("a robot at rest"))];
        let key = DrawKey::of(RunSeed(1), Draw::of(Purpose::Reset));
        world.reset(0, 3, 40, key.0).expect("a known task");
        states.push((Some(index), world.encode(0).expect("a start")));
        states
    };
    (0..).zip(TASKS).flat_map(both).collect()
}

/// A specification, and the answers to each request.
fn answers() -> Vec<Seed> {
    let described =
        wire::DescribeEnvironmentResponse { environment: Some(sample::environment().to_wire()) };
    let rows = |count: usize, size: usize| vec![0.5_f32; count * size];
    let view =
        |count| View { observations: vec![rows(count, 3), rows(count, 2)], state: rows(count, 4) };
    let steps = Steps {
        view: view(2),
        reward: vec![0.5, -1.0],
        terminated: vec![true, false],
        truncated: vec![false, true],
    };
    let state = wire::EnvironmentState { state: vec![7; 64].into() };
    let saved = wire::PlayResponse { answer: Some(Answer::Saved(state)) };
    vec![
        (Some(0), described.encode_to_vec()),
        (Some(1), peer::view_answer(&view(1)).encode_to_vec()),
        (Some(2), peer::steps_answer(&steps).encode_to_vec()),
        (Some(3), saved.encode_to_vec()),
    ]
}
