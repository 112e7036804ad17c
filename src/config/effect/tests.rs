//! Settings without an effect are refused, and no others.

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
    ("policy.input_norm=none", &["algorithm=maddpg"], &["algorithm=hasac"]),
    ("policy.head_gain=0.1", &["algorithm=maddpg"], &["policy.start=runs/one"]),
    ("policy.backpropagation_steps=5", &[], &["algorithm=maddpg"]),
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
    let known: Vec<&str> = known::names().collect();
    let rows = || TABLE.iter().map(|(names, _)| *names).chain([ALWAYS]);
    for key in &known {
        assert_eq!(rows().filter(|names| keys::covers(names, key)).count(), 1, "{key}");
    }
    for name in rows().flatten() {
        assert!(known.iter().any(|key| keys::covers(&[*name], key)), "{name}");
    }
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
    let given: Vec<&str> =
        CASES.iter().map(|(setting, ..)| setting.split_once('=').unwrap().0).collect();
    // The texts of a task file are set by the program; one agent alone needs a task file of its own.
    let others = ["task_file.text", "task_file.model", "update.parameters", "influence.lambda"];
    for (names, _) in TABLE {
        let has_case = given.iter().chain(&others).any(|key| keys::covers(names, key));
        assert!(has_case, "{names:?}");
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
    let config = RunConfig::with(&[OUTSIDE, "policy.sigma_floor=0.1", "influence.lag=1"]).unwrap();
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
    let environment = vec![("S2MIA__MADDPG__BATCH".to_owned(), "10".into())];
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

#[test]
fn a_needed_setting_that_has_no_value_is_shown_as_not_given() {
    let line = RunConfig::with(&["policy.noise_loading=0.5"]).expect_err("refused").to_string();
    assert_eq!(
        line,
        "command line: `policy.noise_loading` has no effect in this run: it needs policy.noise = shared, and policy.noise is \
         not given; leave it out or change that"
    );
}

#[test]
fn of_a_setting_without_an_effect_no_other_value_is_asked() {
    let line = refusal(&["halfcheetah-2x3", "algorithm=hasac", "policy.sigma_scale=0.3"]);
    assert!(line.contains("`policy.sigma_scale` has no effect in this run"), "{line}");
}
