//! Whole configurations: every task, algorithm and preset, and values that are refused.

use super::*;
use crate::config::presets;

#[test]
fn every_section_of_the_defaults_is_read() {
    let resolved = RunConfig::with(&[]).unwrap().resolved;
    let section = |key: &str| key.split_once('.').map(|(section, _)| section.to_owned());
    let mut sections: Vec<String> =
        resolved.entries.keys().filter_map(|key| section(key)).collect();
    sections.dedup();
    // The texts of a task file are read by their keys.
    for unread in sections.iter().filter(|name| *name != "task_file") {
        let mut without = resolved.clone();
        without.entries.retain(|key, _| section(key).as_ref() != Some(unread));
        let text = without.to_toml();
        let is_whole = toml::from_str::<Sections>(&text).is_ok()
            && toml::from_str::<marl::TrainingConfig>(&text).is_ok()
            && toml::from_str::<learner::config::LearnerConfig>(&text).is_ok();
        assert!(!is_whole, "no part of the program reads [{unread}]");
    }
}

fn tasks_and_presets() -> Vec<(&'static str, &'static str)> {
    let presets = || presets::PRESETS.iter().map(|preset| preset.name);
    presets::TASKS.iter().flat_map(|task| presets().map(|preset| (task.name, preset))).collect()
}

#[test]
fn every_task_with_every_algorithm_and_preset_is_valid_but_games_with_a_replay_or_shared_noise() {
    for (task, preset) in tasks_and_presets() {
        for algorithm in presets::ALGORITHMS {
            let of_robots = ["maddpg", "hasac", "happo-shared", "happo-s2mia-exact"];
            let mut layers = presets::of_algorithm(algorithm.name);
            let of_robots = layers.any(|layer| of_robots.contains(&layer.name));
            if sim::Robot::of_task(task).is_err() && of_robots {
                continue;
            }
            let algorithm = format!("algorithm={}", algorithm.name);
            let config = RunConfig::with(&[task, &algorithm, &format!("preset={preset}")]).unwrap();
            assert_eq!(config.task.task, task);
            sim::environments(&config.task, 1).unwrap();
        }
    }
}

#[test]
fn an_external_environment_suits_every_algorithm_and_preset() {
    let (url, harl) = ("environment_service.url=http://localhost:7", "preset=harl");
    for algorithm in presets::ALGORITHMS {
        for preset in presets::PRESETS {
            let algorithm = format!("algorithm={}", algorithm.name);
            RunConfig::with(&[url, &algorithm, &format!("preset={}", preset.name)]).unwrap();
        }
    }
    assert_eq!(
        RunConfig::with(&[url, harl]).unwrap().resolved.text("observation.norm"),
        "feature_z"
    );
}

#[test]
fn a_variant_of_happo_is_its_three_weights_whatever_the_task_and_preset() {
    for (algorithm, alpha, lambda, entropy) in [
        ("happo", 0.0, 0.0, 0.01),
        ("happo-sm", 0.01, 0.0, 0.0),
        ("happo-sm-encoder", 0.01, 0.0, 0.0),
        ("happo-smh", 0.01, 0.0, 0.01),
        ("happo-s2mia", 0.01, 0.01, 0.0),
        ("happo-mi", 0.0, 0.01, 0.0),
        ("happo-0", 0.0, 0.0, 0.0),
        ("happo-shared", 0.0, 0.0, 0.01),
        ("happo-shared-annealed", 0.0, 0.0, 0.01),
        ("happo-s2mia-exact", 0.01, 0.01, 0.0),
    ] {
        for (task, preset) in tasks_and_presets() {
            let shared = ["happo-shared", "happo-shared-annealed", "happo-s2mia-exact"];
            let is_shared = shared.contains(&algorithm);
            if task == "cue-2x1" && is_shared {
                continue;
            }
            let settings = [task, &format!("algorithm={algorithm}"), &format!("preset={preset}")];
            let marl::TrainingConfig { update, surprise, influence, .. } =
                RunConfig::with(&settings).unwrap().training;
            let harls = preset == "harl" && ["walker2d-2x3", "ant-4x2"].contains(&task);
            let entropy = if algorithm == "happo" && harls { 0.0 } else { entropy };
            let found = (surprise.alpha, influence.lambda, update.entropy);
            assert_eq!(found, (alpha, lambda, entropy), "{settings:?}");
        }
    }
}

#[test]
fn variants_of_hasac_are_hasac_but_for_the_weights_of_surprise_and_influence() {
    let training = |name: &str| RunConfig::with(&[&format!("algorithm={name}")]).unwrap().training;
    let (mut plain, surprised) = (training("hasac"), training("hasac-sm"));
    assert_eq!((plain.surprise.alpha, surprised.surprise.alpha), (0.0, 0.01));
    plain.surprise.alpha = 0.01;
    assert_eq!(plain, surprised);
    plain.influence.lambda = 0.01;
    plain.influence.estimator = marl::config::Estimator::Exact;
    assert_eq!(plain, training("hasac-s2mia-exact"));
}

#[test]
fn annealed_noise_is_shared_noise_but_for_its_decay() {
    let of = |settings: &[&str]| RunConfig::with(settings).unwrap();
    let annealed = of(&["algorithm=happo-shared-annealed"]);
    let shared = of(&["algorithm=happo-shared", "policy.noise_decay_steps=500_000"]);
    assert_eq!((annealed.policy, annealed.training), (shared.policy, shared.training));
}

#[test]
fn a_given_value_that_runs_have_without_it_leaves_the_settings_as_they_are() {
    let toml = |settings: &[&str]| RunConfig::with(settings).unwrap().resolved.to_toml();
    let shared = ["algorithm=happo-shared", "policy.noise_hold=1", "policy.noise_decay_steps=0"];
    assert_eq!(toml(&["policy.noise=independent"]), toml(&[]));
    assert_eq!(toml(&shared), toml(&shared[..1]));
    assert_ne!(toml(&[shared[0], "policy.noise_loading=0"]), toml(&shared));
}

#[test]
fn a_run_has_a_million_env_steps_unless_its_length_is_given() {
    for (settings, iterations, env_steps) in [
        (&["run.env_steps=1001"][..], 2, 2_000),
        (&[], 1000, 1_000_000),
        (&["run.iterations=5"], 5, 5_000),
        (&["algorithm=maddpg", "run.iterations=5"], 5, 2_500),
        (&["algorithm=hasac-sm", "run.iterations=5"], 5, 2_500),
    ] {
        let config = RunConfig::with(settings).unwrap();
        let found = (config.iterations(), config.env_steps());
        assert_eq!(found, (iterations, env_steps), "{settings:?}");
    }
}

#[test]
fn a_value_out_of_range_is_laid_at_its_key_and_place() {
    for (setting, words) in [
        ("update.gamma=1.5", "update.gamma"),
        ("update.learning_rate=-1", "update.learning_rate"),
        ("environments.count=0", "environments.count"),
        ("environments.message_steps=25", "environments.message_steps"),
        ("policy.core=lstm", "policy.core"),
        ("policy.hidden=0", "policy.hidden"),
        (
            "critic.width=9223372036854775807",
            "critic.width = 9223372036854775807 is out of range: 2 to 4096",
        ),
        ("critic.layers=17", "critic.layers = 17 is out of range: 1 to 16"),
        ("critic.minibatches=65537", "critic.minibatches"),
        ("update.minibatches=9223372036854775807", "update.minibatches"),
        ("influence.hidden=4097", "influence.hidden"),
        ("maddpg.noise=1e300", "maddpg.noise"),
        ("observation.mode=eyes", "observation.mode"),
        ("observation.norm=mean", "observation.norm"),
        ("critic.core=lstm", "critic.core"),
        ("critic.state_norm=mean", "critic.state_norm"),
        ("run.seed=-1", "run.seed"),
        ("run.actors=100000", "run.actors"),
        ("run.env_steps=0", "run.env_steps"),
        ("surprise.density=oracle", "surprise.density"),
        ("influence.kappa=-1", "influence.kappa"),
        ("influence.lag=2", "influence.lag"),
        ("influence.estimator=count", "influence.estimator"),
        ("lease.ttl_secs=0", "lease.ttl_secs"),
        ("critic.clip=-1", "critic.clip"),
        ("maddpg.replay=2000000", "maddpg.replay"),
        ("maddpg.batch=65537", "maddpg.batch"),
        ("maddpg.polyak=0", "maddpg.polyak"),
        ("log.episodes=some", "log.episodes"),
        ("log.episodes=0", "log.episodes"),
        (
            "surprise.alpha=1e-300",
            "surprise.alpha = 1e-300 is too close to 0; the smallest number above 0",
        ),
        ("update.learning_rate=1e-45", "update.learning_rate = 1e-45 is too close to 0"),
    ] {
        let message = RunConfig::with(&["halfcheetah-6x1", "algorithm=happo", setting])
            .unwrap_err()
            .to_string();
        assert!(message.starts_with("command line: "), "{message}");
        assert!(message.contains(words) && !message.contains('\n'), "{message}");
    }
}

#[test]
fn a_reward_term_that_the_task_does_not_have_is_laid_at_its_own_key() {
    let settings = &["halfcheetah-2x3", "reward.control=0.2", "reward.foo=1"];
    let refused = RunConfig::with(settings).unwrap_err().to_string();
    assert!(
        refused.starts_with("command line: reward.foo: the task has no such term"),
        "{refused}"
    );
}

#[test]
fn a_run_whose_steps_cannot_be_counted_is_refused() {
    for setting in ["run.iterations=9223372036854775807", "run.env_steps=9007199254740993"] {
        let refused = RunConfig::with(&[setting]).err().unwrap().to_string();
        let (key, _) = setting.split_once('=').unwrap();
        assert!(refused.contains(&format!("{key} = ")), "{refused}");
        assert!(refused.contains("is out of range: 0 to 9007199"), "{refused}");
    }
}
