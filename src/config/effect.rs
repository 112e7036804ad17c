//! Which settings have an effect in a run. A setting that the user gives and that has none is refused: a sweep over it would
//! be flat.

use std::fmt;

use Condition::{Above0, Environment, Filled, Is, Zero};
use Property::{Contacts, Continuous, Robot, Several};

use super::conditions::{Condition, INFLUENCE, MADDPG, ON_POLICY, Property, Run, SURPRISE};
use super::error::ConfigError;
use super::resolved::Resolved;
use super::run_config::RunConfig;

const GRU: Condition = Is("policy.core", &["gru"]);
const MLP: Condition = Is("policy.core", &["mlp"]);
/// The estimator with a posterior that is trained.
const LEARNT: Condition = Is("influence.estimator", &["variational_kl"]);
const MLE: Condition = Is("influence.q_training", &["mle"]);

/// The conditions of one alternative must all hold, and one alternative is enough.
type Alternatives = &'static [&'static [Condition]];

/// Every setting that can be without an effect.
const TABLE: &[(&[&str], Alternatives)] = &[
    (&["run.env_steps"], &[&[Zero("run.iterations")]]),
    (&["task_file.text"], &[&[Filled("task_file.model")]]),
    (&["task_file.model"], &[&[Filled("task_file.text")]]),
    (&["environment_service.description"], &[&[Filled("environment_service.url")]]),
    (&["observation.mode"], &[&[Environment(Robot)]]),
    (
        &["observation.nearest", "observation.globals"],
        &[&[Environment(Robot), Is("observation.mode", &["k_nearest"])]],
    ),
    (&["observation.contact_forces"], &[&[Environment(Contacts)]]),
    (&["policy.encoder", "policy.hidden"], &[&[GRU]]),
    (&["policy.width", "policy.layers"], &[&[MLP]]),
    (&["policy.sigma_scale", "policy.sigma_floor"], &[&[ON_POLICY, Environment(Continuous)]]),
    (&["update.parameters"], &[&[Environment(Several)]]),
    (
        &[
            "update.gae_lambda",
            "update.clip",
            "update.epochs",
            "update.minibatches",
            "update.entropy",
            "update.desired_kl",
            "critic.input_norm",
            "critic.epochs",
            "critic.minibatches",
            "critic.clip",
            "critic.huber_delta",
            "critic.normalizer_beta",
        ],
        &[&[ON_POLICY]],
    ),
    (&["surprise.density"], &[&[SURPRISE]]),
    (&["influence.lambda"], &[&[Environment(Several)]]),
    (
        &["influence.estimator", "influence.q_training", "influence.lag", "influence.kappa"],
        &[&[INFLUENCE, Environment(Several)]],
    ),
    (&["influence.encoder", "influence.hidden"], &[&[INFLUENCE, LEARNT, Environment(Several)]]),
    (
        &["influence.posterior_sigma_floor"],
        &[&[INFLUENCE, LEARNT, Environment(Several), Environment(Continuous)]],
    ),
    (
        &[
            "influence.epochs",
            "influence.learning_rate",
            "influence.minibatches",
            "influence.holdout_every",
        ],
        &[&[INFLUENCE, LEARNT, MLE, Environment(Several)]],
    ),
    (
        &[
            "maddpg.replay",
            "maddpg.batch",
            "maddpg.n_step",
            "maddpg.warm_up",
            "maddpg.updates_per_step",
            "maddpg.noise",
            "maddpg.polyak",
        ],
        &[&[MADDPG]],
    ),
    (&["evaluation.episodes", "evaluation.sampled"], &[&[Above0("evaluation.every_steps")]]),
];

/// What `key` lacks for an effect: `None` if it has one. What is not known of the environment is assumed to hold.
fn missing(run: &Run<'_>, key: &str) -> Option<Missing> {
    let (_, alternatives) = TABLE.iter().find(|(keys, _)| keys.contains(&key))?;
    let failing = |all: &&[Condition]| -> Vec<Condition> {
        all.iter().copied().filter(|condition| condition.holds(run) == Some(false)).collect()
    };
    let failing: Vec<Vec<Condition>> = alternatives.iter().map(failing).collect();
    (!failing.iter().any(Vec::is_empty)).then_some(Missing(failing))
}

/// Conditions that do not hold: all of one list are needed.
struct Missing(Vec<Vec<Condition>>);

impl Missing {
    /// The first setting that is not as needed, with its value and origin.
    fn instead(&self, resolved: &Resolved) -> String {
        let first = self.0.iter().flatten().find_map(|condition| condition.setting());
        let shown =
            |key| format!(", and {key} is {} ({})", resolved.plain(key), resolved.origin(key));
        first.map_or_else(String::new, shown)
    }
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = |conditions: &Vec<Condition>| {
            conditions.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ")
        };
        f.write_str(&self.0.iter().map(all).collect::<Vec<_>>().join(", or "))
    }
}

/// Refuses the first setting that the user gave and that has no effect in the run.
pub(super) fn demand(run: &Run<'_>) -> Result<(), ConfigError> {
    let resolved = run.resolved;
    let without = resolved.given.keys().find_map(|key| Some((key, missing(run, key)?)));
    let Some((key, missing)) = without else { return Ok(()) };
    Err(ConfigError::NoEffect {
        place: resolved.origin(key).to_owned(),
        key: key.clone(),
        needs: format!("{missing}{}", missing.instead(resolved)),
    })
}

/// Remarks on settings without an effect, for the comments of a configuration; empty for other settings.
pub(crate) fn remarks(config: &RunConfig) -> impl Fn(&str) -> String {
    let run = Run::of(config, None);
    move |key| {
        let missing = missing(&run, key);
        missing.map_or_else(String::new, |missing| format!("; no effect: it needs {missing}"))
    }
}

#[cfg(test)]
mod tests;
