//! Rules between settings and the agents of a known environment.

use marl::config::{Rule, Sharing};
use policy::{InputNorm, Noise};
use proto::EnvironmentSpec;

use super::resolved::ConfigError;
use super::run_config::RunConfig;

/// Refuses settings that do not go with the agents of the environment.
pub(super) fn demand(config: &RunConfig, environment: &EnvironmentSpec) -> Result<(), ConfigError> {
    demand_equal(config, environment)?;
    demand_several_features(config, environment)?;
    demand_whole_signal(config, environment)
}

/// Refuses shared parameters of agents with different sizes.
fn demand_equal(config: &RunConfig, environment: &EnvironmentSpec) -> Result<(), ConfigError> {
    if config.training.update.parameters == Sharing::Separate {
        return Ok(());
    }
    let sizes = |index: usize| {
        let agent = &environment.agents[index];
        (agent.observation.len(), agent.action.size, agent.action.choices)
    };
    let Some(other) = (1..environment.agents.len()).find(|&index| sizes(index) != sizes(0)) else {
        return Ok(());
    };
    let has = |index: usize| match sizes(index) {
        (features, _, Some(choices)) => {
            format!("{features} observation features and {choices} choices")
        }
        (features, size, None) => {
            format!("{features} observation features and {size} action dimensions")
        }
    };
    let detail = format!(
        "update.parameters = shared needs agents of equal sizes: agent 0 has {}, agent {other} has {}; use separate",
        has(0),
        has(other)
    );
    Err(ConfigError::refused(&config.resolved, &["update.parameters"], &detail))
}

/// Refuses layer norms over a single feature, which make it 0.
fn demand_several_features(
    config: &RunConfig,
    environment: &EnvironmentSpec,
) -> Result<(), ConfigError> {
    let rule = config.training.update.rule;
    let policies = config.policy.input_norm == InputNorm::LayerNorm && rule != Rule::Hasac;
    let critics = config.training.critic.input_norm == InputNorm::LayerNorm
        && matches!(rule, Rule::Happo | Rule::Mappo);
    let blind = environment.agents.iter().find(|agent| agent.observation.len() == 1);
    let (key, whose) = match blind {
        Some(agent) if policies => ("policy.input_norm", agent.name.as_str()),
        _ if critics && environment.state.len() == 1 => ("critic.input_norm", "the state"),
        _ => return Ok(()),
    };
    let detail = format!(
        "{key} = layer_norm is out of range: none, because it would make the only feature of {whose} 0"
    );
    Err(ConfigError::refused(&config.resolved, &[key], &detail))
}

/// Refuses numbers of the shared signal that no action has, with constant loadings.
fn demand_whole_signal(
    config: &RunConfig,
    environment: &EnvironmentSpec,
) -> Result<(), ConfigError> {
    const SIZE: &str = "policy.noise_size";
    let policy = &config.policy;
    let size = policy.noise_size.unwrap_or(1);
    let most = environment.agents.iter().map(|agent| agent.action.size).max().unwrap_or(1);
    let constant = policy.noise_loading.is_some_and(|loading| loading > 0.0);
    if policy.noise != Some(Noise::Shared) || !constant || size <= most {
        return Ok(());
    }
    let detail = format!(
        "{SIZE} = {size} is out of range: 1 to {most}, the largest number of an agent's actions, with a constant policy.noise_loading"
    );
    Err(ConfigError::refused(&config.resolved, &[SIZE], &detail))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(config: &RunConfig) -> EnvironmentSpec {
        sim::environments(&config.task, 1).unwrap().description().clone()
    }

    fn refused(settings: &[&str]) -> String {
        let config = RunConfig::with(settings).unwrap();
        config.demand_suitable(Some(&spec(&config))).unwrap_err().to_string()
    }

    #[test]
    fn agents_with_shared_parameters_must_have_equal_sizes() {
        let config = RunConfig::with(&["update.parameters=shared"]).unwrap();
        let mut spec = spec(&config);
        assert_eq!(config.demand_suitable(Some(&spec)), Ok(()));
        let features = format!("{} observation features", spec.agents[0].observation.len());
        let refused = |spec: &EnvironmentSpec| demand_equal(&config, spec).unwrap_err().to_string();
        spec.agents[1].action.size = 1;
        assert_eq!(
            refused(&spec),
            format!(
                "command line: update.parameters = shared needs agents of equal sizes: agent 0 has {features} and 3 action \
                 dimensions, agent 1 has {features} and 1 action dimensions; use separate"
            )
        );
        for (agent, choices) in spec.agents.iter_mut().zip([3, 5]) {
            (agent.action.size, agent.action.choices) = (1, Some(choices));
        }
        let message = refused(&spec);
        assert!(
            message.contains("and 3 choices, agent 1 ") && message.contains("and 5 choices;"),
            "{message}"
        );
    }

    #[test]
    fn a_layer_norm_of_a_single_feature_and_a_signal_with_unused_numbers_are_refused() {
        let blind = ["signal-2x1", "policy.input_norm=layer_norm"];
        assert_eq!(
            refused(&blind),
            "command line: policy.input_norm = layer_norm is out of range: none, because it would make the only feature of \
             agent_1 0"
        );
        let signal = ["jump-4x1", "algorithm=happo-shared", "policy.noise_size=2"];
        assert_eq!(
            refused(&signal),
            "command line: policy.noise_size = 2 is out of range: 1 to 1, the largest number of an agent's actions, with a \
             constant policy.noise_loading"
        );
        for settings in [
            &["jump-4x1", "policy.input_norm=layer_norm"][..],
            &["jump-4x1", "policy.noise=shared", "policy.noise_size=2"],
            &["halfcheetah-2x3", "algorithm=happo-shared", "policy.noise_size=3"],
        ] {
            let config = RunConfig::with(settings).unwrap();
            assert_eq!(config.demand_suitable(Some(&spec(&config))), Ok(()), "{settings:?}");
        }
    }
}
