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

/// Every setting that can be without an effect, and the conditions that must all hold for one.
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
    (&["policy.input_norm", "policy.head_gain"], &[LAYER_NORMS]),
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
        &[MADDPG],
    ),
    (
        &[
            "hasac.replay",
            "hasac.batch",
            "hasac.n_step",
            "hasac.warm_up",
            "hasac.updates_per_step",
            "hasac.policy_every",
            "hasac.norm_momentum",
            "hasac.initial_temperature",
            "hasac.first_moment",
        ],
        &[HASAC],
    ),
    (&["evaluation.episodes", "evaluation.sampled"], &[Above0("evaluation.every_steps")]),
];

/// The conditions that `key` lacks for an effect; empty if it has one. What is not known of the environment is assumed to
/// hold.
fn lacking(run: &RunContext<'_>, key: &str) -> Vec<Condition> {
    let conditions = match keys::weighted_term(key) {
        Some(_) => Some(&[Environment(Robot)][..]),
        None => TABLE.iter().find(|(keys, _)| keys.contains(&key)).map(|(_, needed)| *needed),
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
    let shown = |key| format!(", and {key} is {} ({})", resolved.plain(key), resolved.origin(key));
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
mod tests {
    use std::collections::BTreeSet;

    use proto::EnvironmentSpec;

    use super::*;
    use crate::config::{Request, known, presets};

    /// Settings that have an effect in every run. Where a run allows only one value, giving that value is right, not without
    /// effect.
    const ALWAYS: &[&str] = &[
        "algorithm",
        "audit.fingerprint",
        "audit.share",
        "checkpoint.every",
        "checkpoint.keep_last",
        "critic.core",
        "critic.layers",
        "critic.learning_rate",
        "critic.max_gradient_norm",
        "critic.state_norm",
        "critic.width",
        "environment_service.url",
        "environments.count",
        "environments.message_steps",
        "environments.per_slot",
        "environments.phase",
        "environments.steps",
        "evaluation.every_steps",
        "learner.connections",
        "learner.other_builds",
        "learner.threads",
        "lease.ttl_secs",
        "log.episodes",
        "observation.norm",
        "policy.backpropagation_steps",
        "policy.core",
        "policy.start",
        "policy.start_sha256",
        "preset",
        "run.actors",
        "run.dir",
        "run.iterations",
        "run.seed",
        "surprise.alpha",
        "task",
        "update.adam_epsilon",
        "update.gamma",
        "update.learning_rate",
        "update.learning_rate_decay",
        "update.max_gradient_norm",
        "update.rule",
    ];

    const OUTSIDE: &str = "environment_service.url=http://localhost:7";

    /// A setting, settings with which it has an effect, and settings with which it has none.
    type Case = (&'static str, &'static [&'static str], &'static [&'static str]);

    /// One case for each row of the table.
    const CASES: &[Case] = &[
        ("run.env_steps=3000", &[], &["run.iterations=2"]),
        ("environment_service.description=ab", &[OUTSIDE], &[]),
        ("observation.mode=full_id", &[], &["task=cue-2x1"]),
        ("observation.nearest=0", &["observation.mode=k_nearest"], &[]),
        ("observation.contact_forces=zeros", &["task=ant-4x2"], &["task=walker2d-2x3"]),
        ("policy.encoder=32", &[], &["policy.core=mlp"]),
        ("policy.layers=3", &["policy.core=mlp"], &[]),
        ("policy.sigma_floor=0.1", &[], &["task=cue-2x1"]),
        ("policy.head_gain=0.1", &["algorithm=maddpg"], &["algorithm=hasac"]),
        ("policy.noise=independent", &[], &["algorithm=maddpg"]),
        ("policy.noise_hold=5", &["policy.noise=shared"], &[]),
        ("policy.noise_decay_steps=5", &["algorithm=happo-shared"], &["algorithm=happo"]),
        ("update.clip=0.2", &[], &["algorithm=maddpg"]),
        ("surprise.density=vae", &[], &["algorithm=happo"]),
        ("influence.estimator=variational_kl", &[], &["algorithm=happo-sm"]),
        ("influence.lag=1", &[], &["algorithm=happo-s2mia-exact"]),
        ("influence.encoder=32", &[], &["task=cue-2x1", "influence.estimator=count"]),
        ("influence.posterior_sigma_floor=0.1", &[], &["task=cue-2x1"]),
        ("influence.holdout_every=4", &[], &["influence.q_training=shared"]),
        ("maddpg.noise=0.2", &["algorithm=maddpg"], &["algorithm=hasac"]),
        ("hasac.n_step=3", &["algorithm=hasac"], &["algorithm=maddpg"]),
        ("evaluation.sampled=true", &[], &["evaluation.every_steps=0"]),
    ];

    fn refusal(settings: &[&str]) -> String {
        RunConfig::with(settings).expect_err("refused").to_string()
    }

    #[test]
    fn every_setting_has_an_effect_always_or_under_conditions() {
        let conditional = TABLE.iter().flat_map(|(keys, _)| keys.iter().copied());
        let listed: Vec<&str> = ALWAYS.iter().copied().chain(conditional).collect();
        let distinct: BTreeSet<&str> = listed.iter().copied().collect();
        assert_eq!(distinct.len(), listed.len(), "a setting is listed twice");
        let known: BTreeSet<&str> = known::names().collect();
        assert_eq!(distinct, known);
    }

    #[test]
    fn a_setting_is_taken_where_it_has_an_effect_and_refused_by_name_where_it_has_none() {
        for (setting, with, without) in CASES {
            let given = |others: &[&'static str]| [others, &[*setting]].concat();
            assert_eq!(RunConfig::with(&given(with)).err(), None, "{setting} {with:?}");
            let (key, _) = setting.split_once('=').unwrap();
            let message = refusal(&given(without));
            let expected = format!("command line: `{key}` has no effect in this run: it needs ");
            assert!(message.starts_with(&expected), "{message}");
        }
    }

    #[test]
    fn every_condition_has_a_case() {
        let given: BTreeSet<&str> =
            CASES.iter().map(|(setting, ..)| setting.split_once('=').unwrap().0).collect();
        // The texts of a task file are set by the program; one agent alone needs a task file of its own.
        let others = ["task_file.text", "task_file.model", "update.parameters", "influence.lambda"];
        for (keys, _) in TABLE {
            let has_case = keys.iter().any(|key| given.contains(key) || others.contains(key));
            assert!(has_case, "{keys:?}");
        }
    }

    #[test]
    fn a_refusal_names_the_setting_the_place_and_what_is_needed_instead() {
        assert_eq!(
            refusal(&["policy.width=256"]),
            "command line: `policy.width` has no effect in this run: it needs policy.core = mlp, and policy.core \
             is gru (configs/base.toml); leave it out or change that"
        );
        assert_eq!(
            refusal(&["algorithm=happo", "influence.epochs=8"]),
            "command line: `influence.epochs` has no effect in this run: it needs influence.lambda above 0, and \
             influence.lambda is 0.0 (configs/algorithms/happo.toml); leave it out or change that"
        );
        assert_eq!(
            refusal(&["cue-2x1", "policy.sigma_floor=0.1"]),
            "command line: `policy.sigma_floor` has no effect in this run: it needs continuous actions; leave it \
             out or change that"
        );
    }

    #[test]
    fn what_only_the_simulator_has_is_refused_for_an_environment_from_outside() {
        let message = refusal(&[OUTSIDE, "observation.mode=k_nearest"]);
        assert!(message.contains("it needs a robot of the simulator"), "{message}");
        assert!(RunConfig::with(&[OUTSIDE, "policy.sigma_floor=0.1", "influence.lag=1"]).is_ok());
    }

    #[test]
    fn an_environment_from_outside_decides_about_settings_once_it_is_known() {
        let config =
            RunConfig::with(&[OUTSIDE, "policy.sigma_floor=0.1", "influence.lag=1"]).unwrap();
        let world = sim::environments(&RunConfig::with(&["cue-2x1"]).unwrap().task, 1).unwrap();
        let mut spec = world.description().clone();
        let refused = |spec: &EnvironmentSpec| {
            config.demand_suitable(Some(spec)).expect_err("refused").to_string()
        };
        assert!(refused(&spec).contains("`policy.sigma_floor`"));
        spec.agents.truncate(1);
        assert!(refused(&spec).contains("`influence.lag`"));
    }

    fn of_file(text: &str, settings: &[&str]) -> Result<RunConfig, ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mine.toml");
        std::fs::write(&file, text).unwrap();
        let settings = settings.iter().map(|setting| (*setting).to_owned()).collect();
        let request = Request { files: vec![file], settings, ..Request::default() };
        RunConfig::of(&request)
    }

    #[test]
    fn every_file_of_the_program_may_also_be_given_as_a_file() {
        for preset in [presets::BASE].iter().chain(presets::TASKS).chain(presets::ALGORITHMS) {
            assert_eq!(of_file(preset.text, &[]).err(), None, "{}", preset.path);
        }
    }

    #[test]
    fn a_file_and_a_variable_are_refused_as_an_argument_is() {
        let message = of_file("[policy]\nlayers = 3\n", &[]).expect_err("refused").to_string();
        assert!(message.contains("mine.toml: `policy.layers` has no effect"), "{message}");
        let environment = vec![("S2MIA__MADDPG__BATCH".to_owned(), "10".to_owned())];
        let request = Request { environment, ..Request::default() };
        let message = RunConfig::of(&request).expect_err("refused").to_string();
        assert!(
            message.starts_with("environment variable S2MIA__MADDPG__BATCH: `maddpg.batch`"),
            "{message}"
        );
    }

    #[test]
    fn a_whole_configuration_may_be_given_again_and_a_change_in_it_that_has_no_effect_is_refused() {
        for settings in [&["ant-2x4", "algorithm=happo"][..], &["cue-2x1", "preset=paper"]] {
            let text = RunConfig::with(settings).unwrap().resolved.to_toml();
            assert!(of_file(&text, &["run.seed=3"]).is_ok());
            let changed = text.replace("batch = 1000", "batch = 999");
            let message = of_file(&changed, &[]).expect_err("refused").to_string();
            assert!(message.contains("`maddpg.batch`"), "{message}");
        }
    }

    #[test]
    fn a_run_with_a_recorded_setting_without_effect_is_resumed_also_if_it_is_given_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("config.toml");
        let text = RunConfig::with(&[]).unwrap().resolved.to_toml();
        std::fs::write(&file, text.replace("width = 128\n", "width = 99\n")).unwrap();
        let resumed = |setting: &str| {
            let settings = vec![setting.to_owned()];
            let request = Request { resumed: Some(file.clone()), settings, ..Request::default() };
            RunConfig::of(&request)
        };
        assert!(resumed("policy.width=99").is_ok());
        assert!(resumed("policy.width=98").is_err());
    }

    #[test]
    fn a_later_setting_that_switches_another_off_is_taken_and_the_other_order_is_refused() {
        let (length, other) = ("run.env_steps=3000", "run.iterations=2");
        assert!(RunConfig::with(&[length, other]).is_ok());
        assert!(refusal(&[other, length]).contains("it needs run.iterations = 0"));
    }

    #[test]
    fn a_printed_configuration_remarks_on_what_has_no_effect() {
        let config = RunConfig::with(&[]).unwrap();
        let text = config.resolved.to_toml_with_origins(remarks(&config));
        let line =
            text.lines().find(|line| line.starts_with("layers = 3  # configs/base.toml;")).unwrap();
        assert!(line.ends_with("; no effect: it needs policy.core = mlp"), "{line}");
    }
}
