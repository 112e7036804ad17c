//! Which settings have an effect in a run. A setting that the user gives and that has none is refused: a sweep over it would
//! be flat.

use Condition::{Above0, Environment, Is, Not, Zero};
use Property::{Contacts, Continuous, Robot, Several};

use super::conditions::{
    Condition, GAUSSIAN, HASAC, INFLUENCE, MADDPG, ON_POLICY, Property, RunContext, SHARED_NOISE,
    SURPRISE,
};
use super::keys;
use super::resolved::{ConfigError, Resolved};
use super::run_config::RunConfig;

const GRU: Condition = Is("policy.core", &["gru"]);
const MLP: Condition = Is("policy.core", &["mlp"]);
/// The estimator with a posterior that is trained.
const LEARNT: Condition = Is("influence.estimator", &["variational_kl"]);
/// Rules whose networks have layer norms.
const LAYER_NORMS: Condition = Is("update.rule", &["happo", "mappo", "maddpg"]);
/// The estimators with a posterior, whose term is a divergence.
const ESTIMATED: Condition = Is("influence.estimator", &["variational_kl", "count"]);
const MLE: Condition = Is("influence.q_training", &["mle"]);

/// Every setting or section that can be without an effect, and the conditions that must all hold for one.
const TABLE: &[(&[&str], &[Condition])] = &[
    (&["run.env_steps"], &[Zero("run.iterations")]),
    (&["task_file.text"], &[Not("task_file.model", "")]),
    (&["task_file.model"], &[Not("task_file.text", "")]),
    (&["environment_service.description"], &[Not("environment_service.url", "")]),
    (&["observation.mode"], &[Environment(Robot)]),
    (
        &["observation.nearest", "observation.globals"],
        &[Environment(Robot), Is("observation.mode", &["k_nearest"])],
    ),
    (&["observation.contact_forces"], &[Environment(Contacts)]),
    (&["policy.encoder", "policy.hidden"], &[GRU]),
    (&["policy.width", "policy.layers"], &[MLP]),
    (&["policy.input_norm"], &[LAYER_NORMS]),
    (&["policy.backpropagation_steps"], &[ON_POLICY]),
    (&["policy.head_gain"], &[LAYER_NORMS, Condition::RandomHead]),
    (&["policy.sigma_scale", "policy.sigma_floor"], &[ON_POLICY, Environment(Continuous)]),
    (&["policy.noise"], &[GAUSSIAN, Environment(Several), Environment(Continuous)]),
    (
        &[
            "policy.noise_loading",
            "policy.noise_size",
            "policy.noise_hold",
            "policy.noise_decay_steps",
        ],
        &[SHARED_NOISE],
    ),
    (&["update.parameters"], &[Environment(Several)]),
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
        &[ON_POLICY],
    ),
    (&["surprise.density"], &[SURPRISE]),
    (&["influence.lambda"], &[Environment(Several)]),
    (
        &["influence.q_training", "influence.lag", "influence.kappa"],
        &[INFLUENCE, ESTIMATED, Environment(Several)],
    ),
    (&["influence.estimator"], &[INFLUENCE, Environment(Several)]),
    (&["influence.encoder", "influence.hidden"], &[INFLUENCE, LEARNT, Environment(Several)]),
    (
        &["influence.posterior_sigma_floor"],
        &[INFLUENCE, LEARNT, Environment(Several), Environment(Continuous)],
    ),
    (
        &[
            "influence.epochs",
            "influence.learning_rate",
            "influence.minibatches",
            "influence.holdout_every",
        ],
        &[INFLUENCE, LEARNT, MLE, Environment(Several)],
    ),
    (&["maddpg."], &[MADDPG]),
    (&["hasac."], &[HASAC]),
    (&["evaluation.episodes", "evaluation.sampled"], &[Above0("evaluation.every_steps")]),
];

/// The conditions that `key` lacks for an effect; empty if it has one. What is not known of the environment is assumed to
/// hold.
fn lacking(run: &RunContext<'_>, key: &str) -> Vec<Condition> {
    let conditions = match keys::weighted_term(key) {
        Some(_) => Some(&[Environment(Robot)][..]),
        None => TABLE.iter().find(|(names, _)| keys::covers(names, key)).map(|(_, needed)| *needed),
    };
    let fails = |condition: &Condition| condition.holds(run) == Some(false);
    conditions.unwrap_or_default().iter().copied().filter(fails).collect()
}

/// The conditions in words.
fn listed(conditions: &[Condition]) -> String {
    conditions.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ")
}

/// The first setting that is not as needed, with its value and origin.
fn instead(lacking: &[Condition], resolved: &Resolved) -> String {
    let first = lacking.iter().find_map(|condition| condition.setting());
    let shown = |key| {
        if resolved.entries.contains_key(key) {
            format!(", and {key} is {} ({})", resolved.plain(key), resolved.origin(key))
        } else {
            format!(", and {key} is not given")
        }
    };
    first.map_or_else(String::new, shown)
}

/// Refuses the first setting that the user gave and that has no effect in the run.
pub(super) fn demand(run: &RunContext<'_>) -> Result<(), ConfigError> {
    let resolved = run.resolved;
    let mut given = resolved.given.keys().map(|key| (key, lacking(run, key)));
    let Some((key, lacking)) = given.find(|(_, lacking)| !lacking.is_empty()) else {
        return Ok(());
    };
    let needs = listed(&lacking);
    let instead = instead(&lacking, resolved);
    let detail = format!(
        "`{key}` has no effect in this run: it needs {needs}{instead}; leave it out or change that"
    );
    Err(ConfigError::at(resolved.origin(key), detail))
}

/// Remarks on settings without an effect, for the comments of a configuration; empty for other settings.
pub(crate) fn remarks(config: &RunConfig) -> impl Fn(&str) -> String {
    let run = RunContext::of(config, None);
    move |key| match lacking(&run, key).as_slice() {
        [] => String::new(),
        lacking => format!("; no effect: it needs {}", listed(lacking)),
    }
}

#[cfg(test)]
mod tests;
