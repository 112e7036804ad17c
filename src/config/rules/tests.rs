//! Values that exclude each other are refused by key, value and reason.

use super::*;

/// Settings that break one rule, and the value that is refused.
const CASES: &[(&[&str], &str)] = &[
    (&["algorithm=maddpg", "update.parameters=shared"], "update.parameters = shared"),
    (&["algorithm=maddpg", "policy.core=gru"], "policy.core = gru"),
    (&["algorithm=maddpg", "observation.norm=running"], "observation.norm = running"),
    (&["algorithm=maddpg", "critic.core=gru"], "critic.core = gru"),
    (&["algorithm=maddpg", "surprise.alpha=0.01"], "surprise.alpha = 0.01"),
    (&["algorithm=maddpg", "critic.state_norm=running"], "critic.state_norm = running"),
    (&["algorithm=maddpg", "influence.lambda=0.01"], "influence.lambda = 0.01"),
    (&["cue-2x1", "algorithm=maddpg"], "update.rule = maddpg"),
    (&["influence.estimator=count"], "influence.estimator = count"),
    (
        &["cue-2x1", "influence.estimator=count", "influence.q_training=shared"],
        "influence.q_training = shared",
    ),
    (&["update.parameters=shared", "influence.q_training=shared"], "influence.q_training = shared"),
    (&["cue-2x1", "influence.q_training=shared"], "influence.q_training = shared"),
    (&["environment_service.url=http://localhost:7", "log.episodes=all"], "log.episodes = all"),
];

#[test]
fn every_rule_refuses_a_value_with_the_allowed_ones() {
    assert_eq!(TABLE.len(), CASES.len());
    for (rule, (settings, value)) in TABLE.iter().zip(CASES) {
        let message = RunConfig::with(settings).expect_err("refused").to_string();
        let expected = format!("{value} is out of range: {}", rule.allowed);
        assert!(message.starts_with("command line: ") && message.ends_with(&expected), "{message}");
    }
}

#[test]
fn a_value_is_taken_where_no_rule_refuses_it() {
    for settings in [
        &["cue-2x1", "influence.estimator=count"][..],
        &["influence.q_training=shared"],
        &["influence.posterior_sigma_floor=0.5"],
        &["environment_service.url=http://localhost:7", "observation.norm=running"],
    ] {
        assert!(RunConfig::with(settings).is_ok(), "{settings:?}");
    }
}

#[test]
fn numbers_of_several_sections_must_fit() {
    for (settings, expected) in [
        (
            &["algorithm=maddpg", "maddpg.replay=9"][..],
            "command line: maddpg.replay = 9 is out of range: at least environments.count = 10, one step of each",
        ),
        (
            &["influence.q_training=shared", "influence.posterior_sigma_floor=0.5"],
            "command line: influence.posterior_sigma_floor = 0.5 is out of range: below policy.sigma_scale = 0.5 with \
             influence.q_training = shared",
        ),
        (
            &["cue-2x1", "algorithm=maddpg"],
            "command line: algorithm = maddpg does not fit: update.rule = maddpg is out of range: happo or mappo for a \
             task with discrete actions",
        ),
    ] {
        let message = RunConfig::with(settings).expect_err("refused").to_string();
        assert_eq!(message, expected);
    }
}

#[test]
fn agents_with_shared_parameters_must_have_equal_sizes() {
    let config = RunConfig::with(&["update.parameters=shared"]).unwrap();
    let world = sim::environments(&config.task, 1).unwrap();
    let mut spec = world.description().clone();
    assert_eq!(config.demand_suitable(Some(&spec)), Ok(()));
    let features = format!("{} observation features", spec.agents[0].observation.len());
    let refused =
        |spec: &EnvironmentSpec| demand_equal_agents(&config, spec).unwrap_err().to_string();
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
