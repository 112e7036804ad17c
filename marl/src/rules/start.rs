//! Begins training from trained policies.

use policy::{ActorPolicy, Array, PolicySnapshot};

use crate::error::MarlError;
use crate::rules::algorithm::Algorithm;

/// Replaces the weights of the policies before the first update by those of `start`, for MADDPG also those of the target
/// policies. Critics, posteriors and optimisers keep their state.
///
/// # Errors
/// If the teams differ in the number of agents or in an agent's network or actions; both are named. If agents that share a
/// network have different policies in `start`.
pub fn start_from(algorithm: &mut dyn Algorithm, start: &PolicySnapshot) -> Result<(), MarlError> {
    demand_networks(&algorithm.snapshot()?, start)?;
    let mut arrays = algorithm.arrays()?;
    for (index, policy) in start.agents.iter().enumerate() {
        let own = format!("agent_{index}");
        for owner in [&own, &format!("target_{own}"), "shared"] {
            for (name, array) in weights(policy) {
                if let Some(replaced) = arrays.get_mut(&format!("weights/{owner}.{name}")) {
                    replaced.clone_from(array);
                }
            }
        }
    }
    algorithm.restore(&arrays)?;
    let begun = algorithm.snapshot()?;
    let mut pairs = begun.agents.iter().zip(&start.agents);
    match pairs.position(|(own, other)| !weights(own).eq(weights(other))) {
        None => Ok(()),
        Some(index) => Err(MarlError::Start(format!(
            "agent {index} cannot have its policy: with update.parameters = shared all agents need the same one"
        ))),
    }
}

/// The arrays of a policy but for the standardisation of its observations.
fn weights(policy: &ActorPolicy) -> impl Iterator<Item = (&String, &Array)> {
    policy.arrays().iter().filter(|(name, _)| !name.starts_with("input."))
}

fn demand_networks(own: &PolicySnapshot, start: &PolicySnapshot) -> Result<(), MarlError> {
    let [expected, found] = [own, start].map(|team| team.agents.len());
    if expected != found {
        let detail = format!("the policies are those of {found} agents, the run has {expected}");
        return Err(MarlError::Start(detail));
    }
    for (index, (own, start)) in own.agents.iter().zip(&start.agents).enumerate() {
        let [expected, found] = [own, start].map(|policy| policy.spec().to_string());
        if expected != found {
            let detail = format!("the policy of agent {index} has {found}; the run has {expected}");
            return Err(MarlError::Start(detail));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use policy::{CoreKind, PolicyConfig, RunSeed};

    use super::*;
    use crate::config::{Rule, Sharing, TrainingConfig};
    use crate::sample;

    fn untrained(config: &TrainingConfig, policy: &PolicyConfig, seed: u64) -> Box<dyn Algorithm> {
        crate::build(config, policy, &sample::problem(), RunSeed(seed)).unwrap()
    }

    /// Settings without a posterior, which MADDPG has not.
    fn with_rule(rule: Rule, parameters: Sharing) -> TrainingConfig {
        let mut config = sample::config();
        (config.update.rule, config.update.parameters) = (rule, parameters);
        config.influence.lambda = 0.0;
        config
    }

    fn refusal(own: &mut dyn Algorithm, start: &PolicySnapshot) -> String {
        start_from(own, start).unwrap_err().to_string()
    }

    #[test]
    fn every_rule_takes_the_policies_and_keeps_all_other_state() {
        for (rule, parameters, replaced) in [
            (Rule::Happo, Sharing::Separate, &["weights/agent_"][..]),
            (Rule::Mappo, Sharing::Shared, &["weights/shared."]),
            (Rule::Maddpg, Sharing::Separate, &["weights/agent_", "weights/target_agent_"]),
        ] {
            let config = with_rule(rule, parameters);
            let policy = PolicyConfig { core: CoreKind::Mlp, ..sample::policy() };
            let start = untrained(&config, &policy, 1).snapshot().unwrap();
            let mut own = untrained(&config, &policy, 2);
            let before = own.arrays().unwrap();
            start_from(own.as_mut(), &start).unwrap();
            let bytes = |policies: &PolicySnapshot| policies.to_bytes().unwrap();
            assert_eq!(bytes(&own.snapshot().unwrap()), bytes(&start), "{rule:?}");
            for (name, array) in own.arrays().unwrap() {
                let is_policy = replaced.iter().any(|prefix| name.starts_with(prefix));
                let is_drawn = name.ends_with("weight") && !name.contains("norm");
                assert_eq!(array != before[&name], is_policy && is_drawn, "{rule:?} {name}");
            }
        }
    }

    #[test]
    fn other_networks_and_teams_are_refused_with_both_shapes() {
        let (config, policy) = (sample::config(), sample::policy());
        let mut own = untrained(&config, &policy, 1);
        let wider = PolicyConfig { encoder: policy.encoder + 1, ..policy.clone() };
        let line = refusal(own.as_mut(), &untrained(&config, &wider, 1).snapshot().unwrap());
        let has = |encoder: usize| {
            format!(
                "has 19 observation features, gru with encoder {encoder}, hidden {} after a layer_norm, 3 Gaussian actions with sigma_scale {}",
                policy.hidden, policy.sigma_scale
            )
        };
        let expected = [has(wider.encoder), has(policy.encoder)].join("; the run ");
        assert_eq!(line, format!("policy.start: the policy of agent 0 {expected}"));
        let mut start = own.snapshot().unwrap();
        start.agents.truncate(1);
        let line = refusal(own.as_mut(), &start);
        assert!(line.ends_with("the policies are those of 1 agents, the run has 2"), "{line}");
    }

    #[test]
    fn agents_that_share_a_network_need_equal_policies() {
        let separate = untrained(&sample::config(), &sample::policy(), 1).snapshot().unwrap();
        let mut own = untrained(&with_rule(Rule::Happo, Sharing::Shared), &sample::policy(), 1);
        assert!(refusal(own.as_mut(), &separate).contains("agent 0 cannot have its policy"));
    }
}
