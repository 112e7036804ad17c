//! What an actor presents at registration: its environments and the bits that its machine computes.

use proto::{ActionSpec, AgentSpec, Digest, EnvironmentSpec, FeatureRole, FeatureSpec};
use sha2::{Digest as _, Sha256};

/// The simulator's description in the words of the wire.
#[must_use]
pub fn environment_spec(description: &sim::Description) -> EnvironmentSpec {
    EnvironmentSpec {
        task: description.task.clone(),
        agents: description.agents.iter().map(agent).collect(),
        state: description.state.iter().map(feature).collect(),
        dt_secs: description.dt_secs,
        episode_steps: description.episode_steps,
        state_kind: description.state_kind.clone(),
        state_version: description.state_version,
        max_state_bytes: description.max_state_bytes,
    }
}

/// SHA-256 over the simulator's and the policy's probes: machines that agree on it roll out alike.
#[must_use]
pub fn rollout_fingerprint() -> Digest {
    let mut hash = Sha256::new();
    hash.update(sim::probe());
    hash.update(policy::probe());
    Digest(hash.finalize().into())
}

fn agent(agent: &sim::AgentDescription) -> AgentSpec {
    AgentSpec {
        name: agent.name.clone(),
        joints: agent.joints.clone(),
        observation: agent.observation.iter().map(feature).collect(),
        seen: agent.seen.iter().map(|&place| place as u32).collect(),
        near: agent.near.iter().map(|&place| place as u32).collect(),
        action: ActionSpec {
            size: agent.action.size as u32,
            low: agent.action.low,
            high: agent.action.high,
            choices: agent.action.choices,
        },
    }
}

fn feature(feature: &sim::Feature) -> FeatureSpec {
    let role = match feature.role {
        sim::FeatureRole::Signal => FeatureRole::Signal,
        sim::FeatureRole::Identity => FeatureRole::Identity,
        sim::FeatureRole::Duplicate => FeatureRole::Duplicate,
        sim::FeatureRole::Constant => FeatureRole::Constant,
    };
    FeatureSpec { name: feature.name.clone(), role }
}
