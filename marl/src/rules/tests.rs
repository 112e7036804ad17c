//! Whole updates with extreme or invalid numbers: an update is skipped, or clamped and counted, and every weight stays
//! finite.

mod state;

use std::fmt::Debug;

use policy::arrays::Array;
use policy::{CoreKind, NamedArrays, PolicyConfig, RunSeed};

use super::*;
use crate::config::{DensityKind, Sharing};
use crate::data::batch::{Batch, Rewards};
use crate::rules::algorithm::Report;
use crate::sample;
use crate::surprise::{Relabelled, Surprise};

const RULES: [(Rule, Sharing); 3] = [
    (Rule::Happo, Sharing::Separate),
    (Rule::Mappo, Sharing::Separate),
    (Rule::Mappo, Sharing::Shared),
];

const MADDPG: (Rule, Sharing) = (Rule::Maddpg, Sharing::Separate);
const HASAC: (Rule, Sharing) = (Rule::Hasac, Sharing::Separate);

/// Whether the rule learns from a replay, with actors without memory.
fn off_policy(config: &TrainingConfig) -> bool {
    matches!(config.update.rule, Rule::Maddpg | Rule::Hasac)
}

fn config((rule, sharing): (Rule, Sharing)) -> TrainingConfig {
    let mut config = sample::config();
    (config.update.rule, config.update.parameters) = (rule, sharing);
    if off_policy(&config) {
        (config.surprise.alpha, config.influence.lambda) = (0.0, 0.0);
    }
    config
}

/// The rule with actors with memory, if it supports them.
fn algorithm(config: &TrainingConfig) -> Box<dyn Algorithm> {
    let core = if off_policy(config) { CoreKind::Mlp } else { CoreKind::Gru };
    let policy = PolicyConfig { core, ..sample::policy() };
    build(config, &policy, &sample::problem(), RunSeed(0)).unwrap()
}

/// The sample's rollout data for the actors of [`algorithm`].
fn batch_for(config: &TrainingConfig) -> Batch {
    let mut batch = sample::batch();
    if off_policy(config) {
        batch.agents.iter_mut().for_each(|agent| agent.hidden.clear());
    }
    batch
}

pub(super) fn plain(batch: &Batch) -> Relabelled<'static> {
    given(vec![batch.reward.clone(); 2])
}

fn given(rewards: Rewards) -> Relabelled<'static> {
    Relabelled { rewards, surprise: None }
}

fn numbers(arrays: &NamedArrays, prefix: &str) -> Vec<f64> {
    let own = arrays.iter().filter(|(name, _)| name.starts_with(prefix));
    own.flat_map(|(_, array)| match array {
        Array::F32 { data, .. } => data.iter().map(|&x| f64::from(x)).collect(),
        Array::F64 { data, .. } => data.clone(),
        _ => Vec::new(),
    })
    .collect()
}

fn assert_finite(algorithm: &mut dyn Algorithm, report: &Report, case: &dyn Debug) {
    assert!(report.iter().all(|(_, value)| value.is_finite()), "{case:?} {report:?}");
    let state = numbers(&algorithm.arrays().unwrap(), "");
    assert!(state.iter().all(|number| number.is_finite()), "{case:?}");
}

pub(super) fn named(report: &Report, name: &str) -> f64 {
    let found = report.iter().find(|(own, _)| own == name);
    found.unwrap_or_else(|| panic!("{name} is not among {report:?}")).1
}

#[test]
fn an_update_with_invalid_or_overflowing_numbers_is_skipped_and_counted() {
    type Change = fn(&mut Batch, &mut Rewards);
    let changes: [(&str, Change); 5] = [
        ("NaN", |_, rewards| rewards[1][30..60].fill(f32::NAN)),
        ("infinite", |_, rewards| rewards[1][30..60].fill(f32::INFINITY)),
        ("minus infinite", |_, rewards| rewards[1][30..60].fill(f32::NEG_INFINITY)),
        ("largest", |_, rewards| rewards[1][30..60].fill(f32::MAX)),
        ("state", |batch, _| batch.state[34..51].fill(f32::MAX)),
    ];
    let whole = sample::batch();
    for rule in RULES {
        for (case, change) in changes {
            let mut algorithm = algorithm(&config(rule));
            let before = algorithm.arrays().unwrap();
            let mut batch = whole.clone();
            let mut rewards = plain(&batch);
            change(&mut batch, &mut rewards.rewards);
            let report = algorithm.update(&batch, &rewards, 0).unwrap();
            assert_eq!(named(&report, "losses/update_skipped"), 1.0, "{rule:?} {case}");
            assert_eq!(algorithm.arrays().unwrap(), before, "{rule:?} {case}");
            let report = algorithm.update(&whole, &plain(&whole), 1).unwrap();
            assert_eq!(named(&report, "losses/update_skipped"), 0.0, "{rule:?} {case}");
            assert_ne!(algorithm.arrays().unwrap(), before, "{rule:?} {case}");
        }
    }
}

#[test]
fn huge_rewards_give_a_finite_update() {
    for rule in RULES {
        let mut algorithm = algorithm(&config(rule));
        let batch = sample::batch();
        let rewards = given(vec![batch.reward.iter().map(|reward| 1e30 * reward).collect(); 2]);
        for iteration in 0..3 {
            let report = algorithm.update(&batch, &rewards, iteration).unwrap();
            assert_finite(algorithm.as_mut(), &report, &rule);
            assert_eq!(named(&report, "agent0/skipped_steps"), 0.0, "{rule:?}");
        }
    }
}

#[test]
fn equal_advantages_change_no_policy_and_are_counted() {
    let mut batch = sample::batch();
    batch.state.fill(0.5);
    batch.finals.iter_mut().for_each(|last| last.state.fill(0.5));
    for rule in RULES {
        let mut config = config(rule);
        (config.update.gae_lambda, config.update.entropy, config.influence.lambda) =
            (0.0, 0.0, 0.0);
        let mut algorithm = algorithm(&config);
        let actors = |algorithm: &dyn Algorithm| algorithm.snapshot().unwrap().to_bytes().unwrap();
        let before = actors(algorithm.as_ref());
        let rewards = given(vec![vec![1e30; batch.rows()]; 2]);
        let report = algorithm.update(&batch, &rewards, 0).unwrap();
        assert_eq!(named(&report, "agent1/advantages_equal"), 1.0, "{rule:?}");
        assert_eq!(actors(algorithm.as_ref()), before, "{rule:?}");
        let mut fresh = self::algorithm(&config);
        let report = fresh.update(&batch, &plain(&batch), 0).unwrap();
        assert_eq!(named(&report, "agent1/advantages_equal"), 0.0, "{rule:?}");
    }
}

/// Densities fitted to a batch.
fn fitted(config: &TrainingConfig, batch: &Batch) -> Surprise {
    let mut surprise = Surprise::new(&config.surprise, &sample::problem(), RunSeed(0)).unwrap();
    surprise.refit(batch, 0).unwrap();
    surprise
}

#[test]
fn constant_features_give_a_finite_update() {
    for still in 1..=19 {
        let mut batch = sample::batch();
        for agent in &mut batch.agents {
            let rows = agent.observation.chunks_exact_mut(19);
            rows.for_each(|row| row[..still].fill(3.0));
        }
        let config = sample::config();
        let mut algorithm = algorithm(&config);
        let report = algorithm.update(&batch, &fitted(&config, &batch).relabel(&batch), 0).unwrap();
        assert_finite(algorithm.as_mut(), &report, &still);
    }
}

#[test]
fn one_environment_with_one_episode_suffices_for_an_update() {
    let mut batch = sample::batch_of(20, 1);
    batch.terminated[19] = true;
    for rule in RULES {
        let mut algorithm = algorithm(&config(rule));
        let report = algorithm.update(&batch, &plain(&batch), 0).unwrap();
        assert_finite(algorithm.as_mut(), &report, &rule);
        // Without a held-out environment its metrics are absent.
        assert!(report.iter().all(|(name, _)| !name.contains("mi_estimate")));
    }
}

#[test]
fn one_step_suffices_for_every_density_and_an_update() {
    let mut batch = sample::batch_of(1, 1);
    batch.terminated[0] = true;
    let policy = PolicyConfig { backpropagation_steps: 1, ..sample::policy() };
    for density in [
        DensityKind::DiagonalGaussian,
        DensityKind::Categorical,
        DensityKind::RandomEncoder,
        DensityKind::Vae,
    ] {
        let mut config = sample::config();
        config.surprise.density = density;
        let mut algorithm = build(&config, &policy, &sample::problem(), RunSeed(0)).unwrap();
        let report = algorithm.update(&batch, &fitted(&config, &batch).relabel(&batch), 0).unwrap();
        assert_eq!(named(&report, "losses/update_skipped"), 0.0, "{density:?}");
        assert_finite(algorithm.as_mut(), &Report::new(), &density);
    }
}

#[test]
fn an_agent_with_overflowing_observations_skips_only_its_own_steps() {
    let mut batch = sample::batch();
    batch.agents[1].observation[38..57].fill(f32::MAX);
    for rule in &RULES[..2] {
        let mut config = config(*rule);
        config.update.minibatches = 1;
        let mut algorithm = algorithm(&config);
        let before = algorithm.arrays().unwrap();
        // In these iterations each of the two agents is updated first at least once.
        for iteration in 0..6 {
            let report = algorithm.update(&batch, &plain(&batch), iteration).unwrap();
            let steps = 2.0 * (iteration + 1) as f64;
            assert_eq!(named(&report, "agent1/skipped_steps"), steps, "{rule:?}");
            assert_eq!(named(&report, "agent0/skipped_steps"), 0.0, "{rule:?}");
        }
        let after = algorithm.arrays().unwrap();
        for (prefix, moves) in [("weights/agent_0.", true), ("weights/agent_1.", false)] {
            assert_eq!(
                numbers(&before, prefix) != numbers(&after, prefix),
                moves,
                "{rule:?} {prefix}"
            );
        }
        assert_finite(algorithm.as_mut(), &Report::new(), rule);
    }
}

#[test]
fn extreme_ratios_and_factors_are_clamped_and_counted() {
    for rule in RULES {
        let mut config = config(rule);
        (config.update.learning_rate, config.update.epochs) = (100.0, 6);
        let mut algorithm = algorithm(&config);
        let batch = sample::batch();
        let report = algorithm.update(&batch, &plain(&batch), 0).unwrap();
        assert!(named(&report, "agent0/ratio_held") > 0.1, "{rule:?} {report:?}");
        if rule.0 == Rule::Happo {
            let held = [0, 1].map(|agent| named(&report, &format!("agent{agent}/factor_held")));
            assert!(held[0].max(held[1]) > 0.1, "{held:?}");
        }
        assert_finite(algorithm.as_mut(), &Report::new(), &rule);
    }
}

#[test]
fn a_collapsing_sigma_stops_at_its_floor_is_counted_and_can_grow_again() {
    let mut batch = sample::batch();
    let square = |action: &[f32]| action.iter().map(|x| x * x).sum::<f32>();
    let pays = |row: usize| -> f32 {
        batch.agents.iter().map(|agent| -square(&agent.action[row * 3..][..3])).sum()
    };
    batch.reward = (0..batch.rows()).map(pays).collect();
    for rule in RULES {
        let mut config = config(rule);
        (config.update.gamma, config.update.entropy) = (0.0, 0.0);
        config.update.learning_rate = 5.0;
        let mut first = algorithm(&config);
        let report = first.update(&batch, &plain(&batch), 0).unwrap();
        assert_eq!(named(&report, "agent0/sigma_floored"), 1.0, "{rule:?} {report:?}");
        assert!((named(&report, "agent0/sigma_smallest") - 0.05).abs() < 1e-6, "{rule:?}");
        (config.update.entropy, config.update.learning_rate) = (10.0, 0.1);
        let mut second = algorithm(&config);
        second.restore(&first.arrays().unwrap()).unwrap();
        for iteration in 1..10 {
            second.update(&batch, &plain(&batch), iteration).unwrap();
        }
        let report = second.update(&batch, &plain(&batch), 10).unwrap();
        assert_eq!(named(&report, "agent0/sigma_floored"), 0.0, "{rule:?}");
        assert_finite(second.as_mut(), &Report::new(), &rule);
    }
}

#[test]
fn nan_is_rejected_by_name_and_nothing_changes() {
    for (rule, action, reward, expected) in [
        (RULES[0], f32::NAN, 0.0, "batch.agents[1].action[3] is NaN"),
        (MADDPG, 0.0, f32::NAN, "batch.rewards[1][3] is NaN"),
        (HASAC, f32::NAN, 0.0, "batch.agents[1].action[3] is NaN"),
    ] {
        let config = config(rule);
        let mut batch = batch_for(&config);
        let mut algorithm = algorithm(&config);
        let before = algorithm.arrays().unwrap();
        let mut rewards = plain(&batch);
        (batch.agents[1].action[3], rewards.rewards[1][3]) = (action, reward);
        let error = algorithm.update(&batch, &rewards, 0).unwrap_err().to_string();
        assert_eq!(error, expected);
        assert_eq!(algorithm.arrays().unwrap(), before, "{rule:?}");
    }
}

#[test]
fn maddpg_stays_finite_with_huge_numbers_and_counts_skipped_steps() {
    type Change = fn(&mut Batch);
    let cases: [(Change, bool); 5] = [
        (|batch| batch.reward.iter_mut().for_each(|reward| *reward *= 1e30), false),
        (|batch| batch.reward.fill(f32::MAX), true),
        (|batch| batch.state.fill(1e38), true),
        (|batch| batch.agents[0].observation.fill(f32::MAX), true),
        (|batch| batch.reward.fill(1.0), false),
    ];
    for (number, (change, skips)) in cases.into_iter().enumerate() {
        let config = config(MADDPG);
        let mut batch = batch_for(&config);
        let mut algorithm = algorithm(&config);
        change(&mut batch);
        let report = algorithm.update(&batch, &plain(&batch), 0).unwrap();
        assert!(named(&report, "replay/updates") > 10.0);
        assert_eq!(named(&report, "agent0/skipped_steps") > 0.0, skips, "{number} {report:?}");
        assert!(numbers(&algorithm.weights().unwrap(), "").iter().all(|x| x.is_finite()));
        assert!(numbers(&algorithm.arrays().unwrap(), "optimizer/").iter().all(|x| x.is_finite()));
    }
}

#[test]
fn hasac_keeps_finite_weights_with_huge_numbers_and_counts_skipped_steps() {
    type Change = fn(&mut Batch);
    let cases: [(Change, Option<bool>); 5] = [
        (|batch| batch.reward.iter_mut().for_each(|reward| *reward *= 1e30), Some(false)),
        (|batch| batch.reward.fill(f32::MAX), Some(true)),
        (|batch| batch.state.fill(1e38), None),
        (|batch| batch.agents[0].observation.fill(f32::MAX), None),
        (|batch| batch.reward.fill(1.0), Some(false)),
    ];
    for (number, (change, skips)) in cases.into_iter().enumerate() {
        let config = config(HASAC);
        let mut batch = batch_for(&config);
        let mut algorithm = algorithm(&config);
        change(&mut batch);
        let report = algorithm.update(&batch, &plain(&batch), 0).unwrap();
        assert!(named(&report, "replay/updates") > 10.0);
        let skipped = named(&report, "losses/value_skipped_steps") > 0.0;
        assert!(skips.is_none_or(|skips| skips == skipped), "{number} {report:?}");
        assert!(numbers(&algorithm.arrays().unwrap(), "").iter().all(|x| x.is_finite()));
    }
}

#[test]
fn rules_with_a_replay_report_the_mean_surprise_of_what_they_drew_if_rewards_contain_it() {
    for rule in [MADDPG, HASAC] {
        let mut config = config(rule);
        let batch = batch_for(&config);
        config.surprise.alpha = 0.5;
        let mut surprise = Surprise::new(&config.surprise, &sample::problem(), RunSeed(0)).unwrap();
        surprise.refit(&batch, 0).unwrap();
        let rewards = surprise.relabel(&batch);
        let pairs = rewards.rewards[1].iter().zip(&batch.reward);
        let bonuses: Vec<f64> = pairs.map(|(own, team)| f64::from(own - team)).collect();
        let report = algorithm(&config).update(&batch, &rewards, 0).unwrap();
        let mean = named(&report, "agent1/surprise_replay_mean");
        assert!(bonuses.iter().any(|x| *x < mean) && bonuses.iter().any(|x| *x > mean), "{mean}");
        let report = algorithm(&config).update(&batch, &plain(&batch), 0).unwrap();
        assert!(report.iter().all(|(name, _)| !name.contains("surprise")), "{report:?}");
    }
}
