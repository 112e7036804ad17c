//! Rules between settings of different sections, and between settings and the environment. The range of a single setting is
//! checked by its section.

use Condition::{Above0, Environment, Is, Not, Zero};
use Property::{Continuous, Discrete};
use marl::config::{CriticCore, QTraining, Rule as RuleName};
use policy::setting::{SettingError, multiple, within};

use super::conditions::{
    Condition, HASAC, INFLUENCE, MADDPG, OFF_POLICY, Property, RunContext, SHARED_NOISE,
};
use super::keys::START;
use super::message_steps::{MESSAGE, SLOT, WINDOW};
use super::resolved::ConfigError;
use super::run_config::RunConfig;

/// A value that does not go with others.
struct Rule {
    /// The value.
    refused: Condition,
    /// What it does not go with: all of these together.
    with: &'static [Condition],
    /// The same in words, and the values that are allowed instead, with the reason.
    conflict: &'static str,
}

const fn rule(refused: Condition, with: &'static [Condition], conflict: &'static str) -> Rule {
    Rule { refused, with, conflict }
}

const TABLE: &[Rule] = &[
    rule(
        Is("update.parameters", &["shared"]),
        &[OFF_POLICY],
        "update.rule = maddpg or hasac; it must be separate",
    ),
    rule(
        Is("policy.core", &["gru"]),
        &[OFF_POLICY],
        "update.rule = maddpg or hasac; it must be mlp: the replay holds single steps, no recurrent states",
    ),
    rule(
        Is("observation.norm", &["running"]),
        &[OFF_POLICY],
        "update.rule = maddpg or hasac; it must be feature_z or none: running statistics would differ from those of the replay",
    ),
    rule(
        Is("critic.core", &["gru"]),
        &[OFF_POLICY],
        "update.rule = maddpg or hasac; it must be mlp: the replay holds single steps, no recurrent states",
    ),
    rule(
        Is("critic.state_norm", &["running"]),
        &[OFF_POLICY],
        "update.rule = maddpg or hasac; it must be none or feature_z: the scale of states in the replay would be stale",
    ),
    rule(
        INFLUENCE,
        &[MADDPG],
        "update.rule = maddpg; it must be 0: a deterministic policy has no density to regularise",
    ),
    rule(
        INFLUENCE,
        &[HASAC, Not("influence.estimator", "exact")],
        "update.rule = hasac and an estimator that learns or counts; it must be 0, or give policy.noise=shared \
         influence.estimator=exact: Eq. 10 adds its divergence to an on-policy surrogate",
    ),
    rule(
        Not(START, ""),
        &[HASAC],
        "update.rule = hasac; leave it out: policies have batch norms folded into their weights, which cannot be trained on",
    ),
    rule(OFF_POLICY, &[Environment(Discrete)], "discrete actions; it must be happo or mappo"),
    rule(
        Is("influence.estimator", &["count"]),
        &[Environment(Continuous)],
        "continuous actions; it must be variational_kl: counts need discrete actions",
    ),
    rule(
        Is("influence.q_training", &["shared"]),
        &[Is("influence.estimator", &["count"])],
        "influence.estimator = count; it must be mle: a table of counts has no parameters to train",
    ),
    rule(
        Is("influence.q_training", &["shared"]),
        &[Is("update.parameters", &["shared"]), INFLUENCE],
        "update.parameters = shared; it must be mle: a trunk has one second head",
    ),
    rule(
        Is("influence.q_training", &["shared"]),
        &[INFLUENCE, Environment(Discrete)],
        "discrete actions; it must be mle",
    ),
    rule(
        SHARED_NOISE,
        &[MADDPG],
        "update.rule = maddpg; it must be independent: its noise is clamped to the range of actions",
    ),
    rule(
        SHARED_NOISE,
        &[Environment(Discrete)],
        "discrete actions; it must be independent: only a Gaussian's noise can be shared",
    ),
    rule(
        Is("influence.estimator", &["exact"]),
        &[Not("policy.noise", "shared")],
        "independent noise; give policy.noise=shared, or make it variational_kl or count: the information between independent \
         actions is 0",
    ),
    rule(
        INFLUENCE,
        &[Is("influence.estimator", &["exact"]), Above0("policy.noise_loading")],
        "influence.estimator = exact and a constant policy.noise_loading; it must be 0: the information is constant",
    ),
    rule(
        Not("log.episodes", "none"),
        &[Not("environment_service.url", "")],
        "environment_service.url; it must be none: only the simulator's episodes are logged",
    ),
    rule(
        Is("log.episodes", &["evaluation"]),
        &[Zero("evaluation.every_steps")],
        "evaluation.every_steps = 0; it must be none, all or a number: no episode is an evaluation's",
    ),
];

impl Rule {
    fn conditions(&self) -> impl Iterator<Item = Condition> {
        [self.refused].into_iter().chain(self.with.iter().copied())
    }

    fn is_broken(&self, run: &RunContext<'_>) -> bool {
        self.conditions().all(|condition| condition.holds(run) == Some(true))
    }
}

/// Refuses the first value that does not go with others, or with the environment as far as it is known.
pub(super) fn demand(run: &RunContext<'_>) -> Result<(), ConfigError> {
    let Some(rule) = TABLE.iter().find(|rule| rule.is_broken(run)) else { return Ok(()) };
    let keys: Vec<&str> = rule.conditions().filter_map(Condition::setting).collect();
    let key = keys[0];
    let found = if run.resolved.entries.contains_key(key) {
        format!("{key} = {} does", run.resolved.plain(key))
    } else {
        format!("{key} is not given, which does")
    };
    let detail = format!("{found} not go with {}", rule.conflict);
    Err(ConfigError::refused(run.resolved, &keys, &detail))
}

/// Refuses another learning rule with the settings that HASAC has alone.
pub(super) fn demand_rule_of_settings(config: &RunConfig) -> Result<(), SettingError> {
    let training = &config.training;
    if training.hasac.is_none() || training.update.rule == RuleName::Hasac {
        return Ok(());
    }
    let range = "hasac with the settings of hasac; use another algorithm";
    Err(SettingError::new("update.rule", config.resolved.text("update.rule"), range))
}

/// Refuses numbers that do not go with those of other sections.
pub(super) fn numbers(config: &RunConfig) -> Result<(), SettingError> {
    let (policy, training) = (&config.policy, &config.training);
    let environments = &config.learner.environments;
    let influence = &training.influence;
    let window = training.sequence_steps(policy);
    multiple(SLOT, environments.steps, WINDOW, window)?;
    multiple(MESSAGE, environments.message_steps, WINDOW, window)?;
    let hold = policy.noise_hold.unwrap_or(1) as usize;
    let range = format!("at most environments.steps = {}", environments.steps);
    within("policy.noise_hold", hold, ..=environments.steps, &range)?;
    match training.update.rule {
        RuleName::Happo | RuleName::Mappo => minibatches(config, window)?,
        RuleName::Maddpg => replay(config, ["maddpg.replay", "maddpg.batch"])?,
        RuleName::Hasac if training.hasac.is_none() => {
            let others =
                "happo, mappo or maddpg without the settings of hasac; use algorithm = hasac";
            return Err(SettingError::new("update.rule", "hasac", others));
        }
        RuleName::Hasac => replay(config, ["hasac.replay", "hasac.batch"])?,
    }
    if influence.q_training == QTraining::Shared && influence.lambda > 0.0 {
        let (floor, scale) = (influence.posterior_sigma_floor, policy.sigma_scale);
        let range =
            format!("below policy.sigma_scale = {scale} with influence.q_training = shared");
        within("influence.posterior_sigma_floor", floor, ..f64::from(scale), &range)?;
    }
    Ok(())
}

/// Refuses more minibatches than an iteration has parts.
fn minibatches(config: &RunConfig, window: usize) -> Result<(), SettingError> {
    let (training, environments) = (&config.training, &config.learner.environments);
    let rows = environments.count * environments.steps;
    let sequences = rows / window;
    let critic = match training.critic.core {
        CriticCore::Mlp => ("steps", rows),
        CriticCore::Gru => ("sequences", sequences),
    };
    for (key, minibatches, (parts, most)) in [
        ("update.minibatches", training.update.minibatches, ("sequences", sequences)),
        ("critic.minibatches", training.critic.minibatches, critic),
        ("influence.minibatches", training.influence.minibatches, ("steps", rows)),
    ] {
        // A preset's number may be larger than a small iteration; only the user's own must have an effect.
        if config.resolved.is_given(key) {
            let range = format!("at most {most}, the number of {parts} of an iteration");
            within(key, minibatches, ..=most, &range)?;
        }
    }
    Ok(())
}

/// Refuses a replay smaller than a step of all environments or than a batch.
fn replay(config: &RunConfig, [capacity, batch]: [&'static str; 2]) -> Result<(), SettingError> {
    let Some(replay) = config.training.replay() else { return Ok(()) };
    let count = config.learner.environments.count;
    let range = format!("at least environments.count = {count}, one step of each");
    within(capacity, replay.capacity, count.., &range)?;
    let range = format!("at most {capacity} = {}", replay.capacity);
    within(batch, replay.batch, ..=replay.capacity, &range)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings that break one rule, and the value that is refused.
    const CASES: &[(&[&str], &str)] = &[
        (&["algorithm=maddpg", "update.parameters=shared"], "update.parameters = shared"),
        (&["algorithm=hasac", "policy.core=gru"], "policy.core = gru"),
        (&["algorithm=maddpg", "observation.norm=running"], "observation.norm = running"),
        (&["algorithm=hasac", "critic.core=gru"], "critic.core = gru"),
        (&["algorithm=maddpg", "critic.state_norm=running"], "critic.state_norm = running"),
        (&["algorithm=maddpg", "influence.lambda=0.01"], "influence.lambda = 0.01"),
        (&["algorithm=hasac", "influence.lambda=0.01"], "influence.lambda = 0.01"),
        (&["algorithm=hasac", "policy.start=runs/one"], "policy.start = runs/one"),
        (&["cue-2x1", "algorithm=maddpg"], "update.rule = maddpg"),
        (&["influence.estimator=count"], "influence.estimator = count"),
        (
            &["cue-2x1", "influence.estimator=count", "influence.q_training=shared"],
            "influence.q_training = shared",
        ),
        (
            &["update.parameters=shared", "influence.q_training=shared"],
            "influence.q_training = shared",
        ),
        (&["cue-2x1", "influence.q_training=shared"], "influence.q_training = shared"),
        (&["algorithm=maddpg", "policy.noise=shared"], "policy.noise = shared"),
        (&["cue-2x1", "policy.noise=shared"], "policy.noise = shared"),
        (&["influence.estimator=exact"], "influence.estimator = exact"),
        (
            &["policy.noise=shared", "influence.estimator=exact", "policy.noise_loading=0.5"],
            "influence.lambda = 0.01",
        ),
        (&["environment_service.url=http://localhost:7", "log.episodes=all"], "log.episodes = all"),
        (&["log.episodes=evaluation", "evaluation.every_steps=0"], "log.episodes = evaluation"),
    ];

    #[test]
    fn every_rule_refuses_a_value_with_the_allowed_ones() {
        assert_eq!(TABLE.len(), CASES.len());
        for (rule, (settings, value)) in TABLE.iter().zip(CASES) {
            let message = RunConfig::with(settings).expect_err("refused").to_string();
            let conflict = format!(" not go with {}", rule.conflict);
            assert!(
                message.starts_with("command line: ") && message.ends_with(&conflict),
                "{message}"
            );
            assert!(message.contains(value), "{message}");
        }
    }

    #[test]
    fn a_value_is_taken_where_no_rule_refuses_it() {
        for settings in [
            &["cue-2x1", "influence.estimator=count"][..],
            &["influence.q_training=shared"],
            &["influence.posterior_sigma_floor=0.5"],
            &["algorithm=hasac", "update.max_gradient_norm=10", "critic.max_gradient_norm=10"],
            &["algorithm=hasac", "policy.noise=shared", "policy.noise_loading=0.7"],
            &["algorithm=hasac", "policy.noise=shared"],
            &[
                "algorithm=hasac",
                "policy.noise=shared",
                "influence.lambda=0.1",
                "influence.estimator=exact",
            ],
            &["algorithm=maddpg", "surprise.alpha=0.01", "surprise.density=vae"],
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
                &["policy.noise=shared", "policy.noise_hold=201"],
                "command line: policy.noise_hold = 201 is out of range: at most environments.steps = 50",
            ),
            (
                &["algorithm=hasac", "hasac.replay=9"],
                "command line: hasac.replay = 9 is out of range: at least environments.count = 10, one step of each",
            ),
            (
                &["algorithm=maddpg", "maddpg.batch=100", "maddpg.replay=99"],
                "command line: maddpg.batch = 100 is out of range: at most maddpg.replay = 99",
            ),
            (
                &["algorithm=hasac", "hasac.replay=255"],
                "command line: hasac.replay = 255 does not fit: hasac.batch = 256 is out of range: at most hasac.replay = 255",
            ),
            (
                &["algorithm=hasac", "hasac.batch=65537"],
                "command line: hasac.batch = 65537 is out of range: 2 to 65536",
            ),
            (
                &["update.rule=hasac"],
                "command line: update.rule = hasac is out of range: happo, mappo or maddpg without the settings of hasac; use \
                 algorithm = hasac",
            ),
            (
                &["algorithm=hasac", "update.rule=happo"],
                "command line: update.rule = happo is out of range: hasac with the settings of hasac; use another algorithm",
            ),
            (
                &["influence.q_training=shared", "influence.posterior_sigma_floor=0.5"],
                "command line: influence.posterior_sigma_floor = 0.5 is out of range: below policy.sigma_scale = 0.5 with \
                 influence.q_training = shared",
            ),
            (
                &["cue-2x1", "algorithm=hasac"],
                "command line: algorithm = hasac does not fit: update.rule = hasac does not go with discrete actions; it \
                 must be happo or mappo",
            ),
            (
                &["cue-2x1", "algorithm=maddpg"],
                "command line: algorithm = maddpg does not fit: update.rule = maddpg does not go with discrete actions; it \
                 must be happo or mappo",
            ),
        ] {
            let message = RunConfig::with(settings).expect_err("refused").to_string();
            assert_eq!(message, expected);
        }
    }

    #[test]
    fn minibatches_without_a_part_of_the_iteration_are_refused() {
        for (settings, expected) in [
            (
                &["environments.count=2", "update.minibatches=11"][..],
                "command line: update.minibatches = 11 is out of range: at most 10, the number of sequences of an iteration",
            ),
            (
                &["environments.count=2", "critic.minibatches=101"],
                "command line: critic.minibatches = 101 is out of range: at most 100, the number of steps of an iteration",
            ),
            (
                &["critic.core=gru", "critic.minibatches=101"],
                "command line: critic.minibatches = 101 is out of range: at most 100, the number of sequences of an iteration",
            ),
            (
                &["environments.count=2", "influence.minibatches=101"],
                "command line: influence.minibatches = 101 is out of range: at most 100, the number of steps of an iteration",
            ),
        ] {
            let message = RunConfig::with(settings).expect_err("refused").to_string();
            assert_eq!(message, expected);
        }
        // A number that the user did not give is no reason to refuse a small iteration.
        assert!(RunConfig::with(&["environments.count=1", "environments.steps=10"]).is_ok());
    }
}
