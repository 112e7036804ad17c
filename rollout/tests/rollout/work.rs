//! A small run of the task in `fixture.rs`, and the work of a slot, also for the tests of other crates.

use proto::{
    Digest, EnvironmentStart, Incarnation, PROTOCOL_VERSION, RolloutWork, RunDescription, Start,
};
use sim::TaskConfig;

use super::fixture::{ENVIRONMENTS, HIDDEN, HIDDEN_EVERY, task};

pub(crate) const STEPS: u32 = 40;
pub(crate) const CHUNK: u32 = 20;

pub(crate) fn run() -> RunDescription {
    run_of(&task())
}

pub(crate) fn run_of(task: &TaskConfig) -> RunDescription {
    let world = sim::environments(task, ENVIRONMENTS).unwrap();
    RunDescription {
        run_id: "test".to_owned(),
        protocol_version: PROTOCOL_VERSION,
        incarnation: Incarnation(1),
        seed: 3,
        task_settings: serde_json::to_string(task).unwrap(),
        environment: world.description().clone(),
        environments_per_slot: ENVIRONMENTS as u32,
        slot_steps: STEPS,
        chunk_steps: CHUNK,
        hidden_sizes: vec![HIDDEN as u32; world.description().agents.len()],
        hidden_every: HIDDEN_EVERY,
        rollout_fingerprint: rollout::rollout_fingerprint(),
        config_sha256: Digest([0; 32]),
        heartbeat_secs: 0.05,
        settings_toml: "task = \"halfcheetah-2x3\"".to_owned(),
        build: "0.1.0+abc".to_owned(),
        other_builds: false,
        sampled_evaluations: false,
        restores_observations: true,
    }
}

/// Work of slot 3, whose first environment is truncated inside the slot.
pub(crate) fn fresh_work() -> RolloutWork {
    let start = |environment, limit| EnvironmentStart {
        environment,
        start: Start::Fresh { episode: 0, limit },
    };
    RolloutWork { iteration: 4, slot: 3, environments: vec![start(6, 15), start(7, 1000)] }
}
