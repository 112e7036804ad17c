//! What a fuzz target and the inputs that it begins with must agree on.

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorNetwork, ActorPolicy, CoreKind, Head, PolicyConfig, PolicySnapshot};
use proto::{Digest, PolicyVersion, WeightsName};
use recording::RecordedRun;
use rollout::EvaluationEpisode;
use sim::{
    ContactForces, EnvironmentBatch, ObservationConfig, ObservationMode, ObservationNorm, RootView,
    TaskConfig, TaskDefinition,
};

/// A robot of each kind and the game; an input of `environment_state` names one by its place here.
pub const TASKS: [&str; 4] = ["halfcheetah-2x3", "walker2d-2x3", "ant-2x4", "cue-2x1"];

/// One world of an entry of [`TASKS`].
///
/// # Panics
/// If the task is not known.
#[must_use]
pub fn world(task: &str) -> Box<dyn EnvironmentBatch> {
    let config =
        TaskConfig { task: task.to_owned(), definition: None, observation: observation() };
    sim::environments(&config, 1).expect("a known task")
}

fn observation() -> ObservationConfig {
    ObservationConfig {
        mode: ObservationMode::FullId,
        norm: ObservationNorm::None,
        nearest: 0,
        globals: RootView::Shown,
        contact_forces: ContactForces::Absent,
    }
}

/// A small recorded run: two episodes of at most eight steps of the hopper of docs/ADDING_A_TASK.md.
///
/// # Panics
/// If the hopper cannot be recorded.
#[must_use]
pub fn recording() -> Vec<u8> {
    let config = hopper();
    let mut world = sim::environments(&config, 1).expect("the documented example");
    let sizes = world.description().agents.iter();
    let sizes = sizes.map(|agent| (agent.observation.len(), agent.action.size));
    let agents =
        sizes.map(|(observation, action)| small_policy(CoreKind::Mlp, observation, action));
    let policy = PolicySnapshot { agents: agents.collect() };
    let run = RecordedRun {
        policy: &policy,
        weights: WeightsName { version: PolicyVersion(3), digest: Digest([9; 32]) },
        metadata: [("run_id".to_owned(), "fuzz".to_owned())].into(),
        settings_toml: String::new(),
        task_settings: serde_json::to_string(&config).expect("settings of a task"),
    };
    let episode = |index| EvaluationEpisode { seed: RunSeed(1), iteration: 3, index };
    let file = tempfile::NamedTempFile::new().expect("a writable temporary folder");
    recording::record(world.as_mut(), &run, &[episode(0), episode(1)], file.path(), |_, _| {})
        .expect("the hopper can be recorded");
    std::fs::read(file.path()).expect("the file just written")
}

fn hopper() -> TaskConfig {
    let mut definition = TaskDefinition::example();
    definition.file = definition.file.replace("episode_steps = 1000", "episode_steps = 8");
    TaskConfig {
        task: "hopper-2x1".to_owned(),
        definition: Some(definition),
        observation: observation(),
    }
}

/// A network of a few units.
///
/// # Panics
/// If it cannot be built.
#[must_use]
pub fn small_policy(core: CoreKind, observation: usize, action: usize) -> ActorPolicy {
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
