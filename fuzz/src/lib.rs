//! What a fuzz target and the inputs that it begins with must agree on.

#[expect(dead_code, reason = "the tests of rollouts need more of it")]
#[path = "../../rollout/tests/rollout/fixture.rs"]
mod fixture;

use policy::randomness::RunSeed;
use proto::{Digest, PolicyVersion, WeightsName};
use recording::RecordedRun;
use rollout::EvaluationEpisode;
use sim::{EnvironmentBatch, ObservationConfig, ObservationNorm, TaskConfig, TaskDefinition};

/// A robot of each kind and the game; an input of `environment_state` names one by its place here.
pub const TASKS: [&str; 4] = ["halfcheetah-2x3", "walker2d-2x3", "ant-2x4", "cue-2x1"];

/// One world of an entry of [`TASKS`].
///
/// # Panics
/// If the task is not known.
#[must_use]
pub fn world(name: &str) -> Box<dyn EnvironmentBatch> {
    sim::environments(&task(name, None), 1).expect("a known task")
}

fn task(name: &str, definition: Option<TaskDefinition>) -> TaskConfig {
    let usual = fixture::task().observation;
    let observation = ObservationConfig { norm: ObservationNorm::None, ..usual };
    TaskConfig { task: name.to_owned(), definition, weights: None, observation }
}

/// A small recorded run: two episodes of at most eight steps of the hopper of docs/ADDING_A_TASK.md.
///
/// # Panics
/// If the hopper cannot be recorded.
#[must_use]
pub fn recording() -> Vec<u8> {
    let mut definition = TaskDefinition::example();
    definition.file = definition.file.replace("episode_steps = 1000", "episode_steps = 8");
    let config = task("hopper-2x1", Some(definition));
    let mut world = sim::environments(&config, 1).expect("the documented example");
    let policy = fixture::policy_for(world.description());
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
