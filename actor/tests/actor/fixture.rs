//! A small run of a real task: description, policy, work.

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorNetwork, CoreKind, InputNorm, PolicyConfig, PolicySnapshot, RefreshHidden};
use proto::{
    Digest, EnvironmentStart, Incarnation, PROTOCOL_VERSION, RolloutWork, RunDescription, Start,
};
use sim::{
    ContactForces, EnvironmentBatch, ObservationConfig, ObservationMode, ObservationNorm,
    PartitionSemantics, RootView, TaskConfig,
};

pub(crate) const ENVIRONMENTS: usize = 2;
pub(crate) const STEPS: u32 = 40;
pub(crate) const CHUNK: u32 = 20;
pub(crate) const HIDDEN_EVERY: u32 = 10;
pub(crate) const HIDDEN: usize = 8;

pub(crate) fn task() -> TaskConfig {
    TaskConfig {
        task: "halfcheetah-2x3".to_owned(),
        definition: None,
        observation: ObservationConfig {
            mode: ObservationMode::FullId,
            norm: ObservationNorm::FeatureZ,
            nearest: 1,
            globals: RootView::Hidden,
            contact_forces: ContactForces::Absent,
        },
        partition: PartitionSemantics::ActuatorSlices,
    }
}

pub(crate) fn world() -> Box<dyn EnvironmentBatch> {
    sim::environments(&task(), ENVIRONMENTS).unwrap()
}

pub(crate) fn policy() -> PolicySnapshot {
    policy_for(world().description())
}

pub(crate) fn policy_for(description: &sim::Description) -> PolicySnapshot {
    let config = PolicyConfig {
        core: CoreKind::Gru,
        input_norm: InputNorm::LayerNorm,
        encoder: 8,
        hidden: HIDDEN,
        width: 8,
        layers: 1,
        backpropagation_steps: HIDDEN_EVERY as usize,
        burn_in: 0,
        refresh_hidden: RefreshHidden::Never,
        initial_sigma: 0.365_529_29,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 1.0,
    };
    let agent = |(index, shape): (usize, &sim::AgentDescription)| {
        let mut rng = generator(RunSeed(5), Draw::of(Purpose::Initialisation).agent(index as u32));
        let (observation, action) = (shape.observation.len(), shape.action.size);
        let dtype = candle_core::DType::F32;
        ActorNetwork::new(&config, observation, action, dtype, &mut rng).unwrap().policy().unwrap()
    };
    PolicySnapshot { agents: description.agents.iter().enumerate().map(agent).collect() }
}

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
        environment: actor::environment_spec(world.description()),
        environments_per_slot: ENVIRONMENTS as u32,
        slot_steps: STEPS,
        chunk_steps: CHUNK,
        hidden_sizes: vec![HIDDEN as u32; world.description().agents.len()],
        hidden_every: HIDDEN_EVERY,
        rollout_fingerprint: actor::rollout_fingerprint(),
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
