//! A small run with two unlike agents, and chunks of it.

use proto::{
    ActionSpec, AgentChunk, AgentSpec, Digest, EnvironmentSpec, FeatureRole, FeatureSpec,
    FinalStep, Incarnation, PROTOCOL_VERSION, RolloutOrigin, RunDescription, SlotEnd,
    TrajectoryChunk,
};

fn features(count: usize, role: FeatureRole) -> Vec<FeatureSpec> {
    (0..count).map(|i| FeatureSpec { name: format!("feature_{i}"), role }).collect()
}

fn agent(name: &str, observation: usize, action: usize) -> AgentSpec {
    AgentSpec {
        name: name.to_owned(),
        joints: vec![format!("{name}.hip"), format!("{name}.knee")],
        observation: [
            features(2, FeatureRole::Signal),
            features(observation - 2, FeatureRole::Identity),
        ]
        .concat(),
        seen: vec![0, 2],
        near: vec![3],
        action: ActionSpec { size: action, low: -1.0, high: 1.0, choices: None },
    }
}

pub(crate) fn environment() -> EnvironmentSpec {
    let roles =
        [FeatureRole::Signal, FeatureRole::Identity, FeatureRole::Duplicate, FeatureRole::Constant];
    EnvironmentSpec {
        task: "rapier/halfcheetah-2x3".to_owned(),
        agents: vec![agent("agent_0", 3, 2), agent("agent_1", 2, 1)],
        state: roles.into_iter().flat_map(|role| features(1, role)).collect(),
        dt_secs: 0.05,
        episode_steps: 1000,
        state_kind: "s2mia.rapier".to_owned(),
        state_version: 1,
        max_state_bytes: 64,
        feature_z: false,
        reward_terms: ["forward_speed", "control"].map(str::to_owned).into(),
    }
}

/// The slot of the sample's chunks.
pub(crate) fn origin() -> RolloutOrigin {
    RolloutOrigin { iteration: 3, slot: 0, environments: vec![0, 1] }
}

/// Slots of 2 environments and 2 chunks of 2 steps; agent 0 has 3 recurrent units, agent 1 none.
pub(crate) fn run() -> RunDescription {
    RunDescription {
        run_id: "test".to_owned(),
        protocol_version: PROTOCOL_VERSION,
        incarnation: Incarnation(11),
        seed: 7,
        task_settings: "{}".to_owned(),
        environment: environment(),
        environments_per_slot: 2,
        slot_steps: 4,
        chunk_steps: 2,
        hidden_sizes: vec![3, 0],
        hidden_every: 2,
        rollout_fingerprint: Digest([1; 32]),
        config_sha256: Digest([2; 32]),
        heartbeat_secs: 5.0,
        settings_toml: "task = \"toy\"".to_owned(),
        build: "0.1.0+abc".to_owned(),
        other_builds: false,
        sampled_evaluations: true,
        restores_observations: true,
    }
}

fn numbers(count: usize, from: f32) -> Vec<f32> {
    (0..count).map(|i| from + i as f32 * 0.25).collect()
}

/// The agents' observations of the global states `[n, 4]`, as the description says; only the first has an identity.
fn observations(states: &[f32]) -> [Vec<f32>; 2] {
    let rows = |constants: &[f32]| {
        let row = |state: &[f32]| [&[state[0], state[2]][..], constants].concat();
        states.chunks(4).flat_map(row).collect::<Vec<_>>()
    };
    [rows(&[1.0]), rows(&[])]
}

fn final_step(step: u32, environment: u32) -> FinalStep {
    let observation = vec![numbers(3, 5.0), numbers(2, 6.0)];
    FinalStep { step, environment, state: numbers(4, step as f32), observation }
}

/// Chunk 0 ends an episode in each environment's way. Chunk 1 ends the slot; its observations are copies of the states.
pub(crate) fn chunk(sequence: u32) -> TrajectoryChunk {
    let mut chunk = uncopied(sequence);
    if sequence == 1 {
        for (agent, rows) in chunk.agents.iter_mut().zip(observations(&chunk.state)) {
            agent.observation = rows;
        }
        for last in &mut chunk.finals {
            last.observation = observations(&last.state).into();
        }
    }
    chunk
}

fn uncopied(sequence: u32) -> TrajectoryChunk {
    let last = sequence == 1;
    let finals = if last { [(3, 0), (3, 1)] } else { [(0, 1), (1, 0)] };
    TrajectoryChunk {
        sequence,
        first_step: 2 * sequence,
        steps: 2,
        agents: vec![
            AgentChunk {
                observation: numbers(12, 0.0),
                action: numbers(8, -1.0),
                log_prob: numbers(4, -3.0),
                hidden: numbers(6, 0.0),
            },
            AgentChunk {
                observation: numbers(8, 1.0),
                action: numbers(4, -0.5),
                log_prob: numbers(4, -2.0),
                hidden: Vec::new(),
            },
        ],
        state: numbers(16, 2.0),
        reward: numbers(4, -0.0),
        terminated: vec![false, !last, false, false],
        truncated: vec![false, false, !last, false],
        finals: finals
            .into_iter()
            .map(|(step, environment)| final_step(step, environment))
            .collect(),
        end: last.then(|| SlotEnd {
            environments: vec![vec![1, 2, 3], vec![4]],
            recurrent: vec![numbers(6, 0.5), Vec::new()],
        }),
        reward_terms: vec![1.5, -0.25, 2.0, -0.5],
    }
}
