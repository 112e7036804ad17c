//! Data for an actor's registration: the environment's specification and the numeric fingerprint.

use std::sync::LazyLock;

use proto::{ActionSpec, AgentSpec, Digest, EnvironmentSpec, FeatureRole, FeatureSpec};
use sha2::{Digest as _, Sha256};

/// Converts the simulator's description to the protocol's specification.
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
        feature_z: false,
    }
}

/// SHA-256 of the probes of simulator and policy. Programs with equal fingerprints compute equal rollouts. The first
/// call computes it, which takes a moment.
#[must_use]
pub fn rollout_fingerprint() -> Digest {
    static FINGERPRINT: LazyLock<Digest> = LazyLock::new(|| {
        let mut hash = Sha256::new();
        hash.update(sim::probe());
        hash.update(policy::probe());
        Digest(hash.finalize().into())
    });
    *FINGERPRINT
}

/// Converts the protocol's specification to the simulator's description; the inverse of [`environment_spec`].
#[must_use]
pub fn description(spec: &EnvironmentSpec) -> sim::Description {
    sim::Description {
        task: spec.task.clone(),
        agents: spec.agents.iter().map(described_agent).collect(),
        state: spec.state.iter().map(described_feature).collect(),
        dt_secs: spec.dt_secs,
        episode_steps: spec.episode_steps,
        state_kind: spec.state_kind.clone(),
        state_version: spec.state_version,
        max_state_bytes: spec.max_state_bytes,
    }
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

fn described_agent(agent: &AgentSpec) -> sim::AgentDescription {
    let ActionSpec { size, low, high, choices } = agent.action;
    sim::AgentDescription {
        name: agent.name.clone(),
        joints: agent.joints.clone(),
        observation: agent.observation.iter().map(described_feature).collect(),
        seen: agent.seen.iter().map(|&place| place as usize).collect(),
        near: agent.near.iter().map(|&place| place as usize).collect(),
        action: sim::ActionRange { size: size as usize, low, high, choices },
    }
}

fn described_feature(feature: &FeatureSpec) -> sim::Feature {
    let role = match feature.role {
        FeatureRole::Signal => sim::FeatureRole::Signal,
        FeatureRole::Identity => sim::FeatureRole::Identity,
        FeatureRole::Duplicate => sim::FeatureRole::Duplicate,
        FeatureRole::Constant => sim::FeatureRole::Constant,
    };
    sim::Feature { name: feature.name.clone(), role }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_survives_the_round_trip_through_its_specification() {
        let config = serde_json::json!({
            "task": "ant-4x2",
            "observation": {
                "mode": "k_nearest", "norm": "none", "nearest": 1, "globals": "shown", "contact_forces": "zeros",
            },
            "partition": "labels",
        });
        let task = serde_json::from_value(config).unwrap();
        let own = sim::environments(&task, 1).unwrap();
        assert_eq!(&description(&environment_spec(own.description())), own.description());
    }
}
