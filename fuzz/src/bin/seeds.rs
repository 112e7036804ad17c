//! Writes what fuzzing begins with into `fuzz/corpus`: for each target a few inputs as the program itself makes them.

#[path = "../../../proto/tests/wire/sample.rs"]
mod sample;

use std::fs;
use std::path::{Path, PathBuf};

use candle_core::DType;
use fuzz::{TASKS, world};
use policy::randomness::{Draw, Key, Purpose, RunSeed, generator};
use policy::{ActorNetwork, CoreKind, InputNorm, PolicyConfig, PolicySnapshot, RefreshHidden};
use prost::Message;
use proto::wire::push_trajectory_request::Content;
use proto::{
    Digest, EnvironmentStart, EvaluationResult, Incarnation, Lease, LeaseAnswer, LeaseId,
    PROTOCOL_VERSION, PolicyVersion, PushHeader, Registration, RolloutWork, Start, WeightsName,
    Work,
};
use sim::ContactForces;

/// An input, with the byte before it by which its target chooses how to read it, if it does.
type Seed = (Option<u8>, Vec<u8>);

fn main() {
    for (target, seeds) in [
        ("chunk", messages()),
        ("config", settings()),
        ("arrays", policies()),
        ("environment_state", states()),
        ("checkpoint", noise()),
        ("slots", noise()),
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

/// In the order in which the target tells its kinds apart.
fn messages() -> Vec<Seed> {
    let run = sample::run();
    let push = |content, digest| PushHeader::of(&lease(), digest).to_wire(content).encode_to_vec();
    let chunk = |sequence| {
        let (message, digest) = sample::chunk(sequence).to_wire(&run, &sample::origin());
        push(Content::Chunk(message), digest)
    };
    let result = EvaluationResult { episode: 0, extrinsic_return: 12.5, steps: 40 };
    let registration = Registration {
        client: "seed".to_owned(),
        build: run.build.clone(),
        protocol_version: PROTOCOL_VERSION,
        environment: sample::environment(),
        rollout_fingerprint: Some(run.rollout_fingerprint),
    };
    let mut seeds = vec![
        (Some(0), chunk(0)),
        (Some(0), chunk(1)),
        (Some(0), push(Content::Evaluation(result.to_wire()), result.digest(3))),
        (Some(1), registration.to_wire().encode_to_vec()),
        (Some(2), LeaseAnswer::Lease(lease()).to_wire().encode_to_vec()),
        (Some(2), LeaseAnswer::Retry { wait_millis: 100 }.to_wire().encode_to_vec()),
        (Some(3), run.to_wire().encode_to_vec()),
    ];
    seeds.extend(noise().into_iter().map(|(_, bytes)| (Some(4), bytes)));
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
    let policy = |core| {
        let config = PolicyConfig {
            core,
            input_norm: InputNorm::LayerNorm,
            encoder: 4,
            hidden: 3,
            width: 4,
            layers: 1,
            backpropagation_steps: 5,
            burn_in: 0,
            refresh_hidden: RefreshHidden::Never,
            initial_sigma: 0.365_529_29,
            sigma_scale: 0.5,
            sigma_floor: 0.05,
            head_gain: 1.0,
        };
        let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
        let network = ActorNetwork::new(&config, 5, 2, DType::F32, &mut rng);
        network.and_then(|network| network.policy()).expect("a small network")
    };
    let snapshot = |cores: &[CoreKind]| {
        let agents = cores.iter().map(|core| policy(*core)).collect();
        (None, PolicySnapshot { agents }.to_bytes().expect("a small policy"))
    };
    vec![
        snapshot(&[CoreKind::Gru]),
        snapshot(&[CoreKind::Mlp]),
        snapshot(&[CoreKind::Gru, CoreKind::Mlp]),
    ]
}

/// Robots at rest and at the start of an episode.
fn states() -> Vec<Seed> {
    let both = |(index, task): (u8, (&str, ContactForces))| {
        let mut world = world(task);
        let mut states = vec![(Some(index), world.encode(0).expect("a robot at rest"))];
        let key = Key::of(RunSeed(1), Draw::of(Purpose::Reset));
        world.reset(0, 3, 40, key.0).expect("a known task");
        states.push((Some(index), world.encode(0).expect("a start")));
        states
    };
    (0..).zip(TASKS).flat_map(both).collect()
}

/// Bytes for targets that read them as lists of events.
fn noise() -> Vec<Seed> {
    let bytes = |index: u32| {
        let mut rng = generator(RunSeed(u64::from(index)), Draw::of(Purpose::Reset));
        let bytes = (0..64 << index).map(|_| policy::randomness::uniform(&mut rng));
        (None, bytes.map(|share: f32| (share * 255.0) as u8).collect())
    };
    (0..6).map(bytes).collect()
}
