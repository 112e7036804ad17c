//! The state of every rule: it is stored and restored bit for bit, and is the same on any number of threads.

use policy::Head;

use super::*;
use crate::config::{CriticCore, StateNorm};
use crate::data::batch::Final;

const HAPPO: (Rule, Sharing) = RULES[0];
const HAPPO_SHARED: (Rule, Sharing) = (Rule::Happo, Sharing::Shared);
const MAPPO: (Rule, Sharing) = RULES[1];
const MAPPO_SHARED: (Rule, Sharing) = RULES[2];
const ON_POLICY: [(Rule, Sharing); 4] = [HAPPO, HAPPO_SHARED, MAPPO, MAPPO_SHARED];

/// An update with the sample's data, in which one episode terminates and another one is truncated inside a chunk.
fn update(algorithm: &mut dyn Algorithm, config: &TrainingConfig, iteration: u64) -> Report {
    let mut batch = batch_for(config);
    // The sample has one final state for each environment, in their order.
    let ends = [(3, 0), (12, 4)];
    let finals =
        ends.map(|(step, environment)| Final { step, ..batch.finals[environment].clone() });
    let [terminated, truncated] =
        ends.map(|(step, environment)| step * batch.environments + environment);
    batch.terminated[terminated] = true;
    batch.truncated[truncated] = true;
    drop(batch.finals.splice(0..0, finals));
    algorithm.update(&batch, &plain(&batch), iteration).unwrap()
}

/// The names that begin with `prefix`.
fn under<'a>(arrays: &'a NamedArrays, prefix: &'a str) -> impl Iterator<Item = &'a String> {
    arrays.keys().filter(move |name| name.starts_with(prefix))
}

#[test]
fn sample_reuse_is_the_epochs_or_the_replays_draws_per_transition() {
    // A tenth of a batch of 64 is 6.4.
    for (rule, reuse) in [(HAPPO, 5.0), (MAPPO, 5.0), (MADDPG, 6.4), (HASAC, 6.4)] {
        let mut config = config(rule);
        config.update.epochs = 5;
        config.maddpg.batch = 64;
        config.hasac.as_mut().unwrap().batch = 64;
        let found = config.sample_reuse();
        assert!((found - reuse).abs() < 1e-12, "{rule:?}: {found}, expected {reuse}");
    }
}

#[test]
fn every_rule_and_critic_continues_bit_for_bit_from_its_stored_state() {
    let (mlp, gru) = (CriticCore::Mlp, CriticCore::Gru);
    for (rule, core, alpha) in [
        (HAPPO, mlp, 0.0),
        (HAPPO, mlp, 0.01),
        (HAPPO, gru, 0.0),
        (HAPPO, gru, 0.01),
        (HAPPO_SHARED, mlp, 0.0),
        (MAPPO, gru, 0.01),
        (MAPPO_SHARED, mlp, 0.01),
        (MADDPG, mlp, 0.0),
        (HASAC, mlp, 0.0),
    ] {
        let case = format!("{rule:?} {core:?} {alpha}");
        let mut config = config(rule);
        (config.critic.core, config.surprise.alpha) = (core, alpha);
        let on_policy = !off_policy(&config);
        if on_policy {
            config.critic.state_norm = StateNorm::Running;
        }
        let (mut kept, mut other) = (algorithm(&config), algorithm(&config));
        for iteration in 0..4 {
            update(kept.as_mut(), &config, iteration);
        }
        update(other.as_mut(), &config, 7);
        let stored = kept.arrays().unwrap();
        let remembered = numbers(&stored, "memory/critic").iter().any(|&value| value != 0.0);
        assert_eq!(remembered, core == gru, "{case}");
        other.restore(&stored).unwrap();
        // The replay holds the rows of five iterations.
        for iteration in 4..8 {
            let report = update(kept.as_mut(), &config, iteration);
            update(other.as_mut(), &config, iteration);
            if on_policy {
                let influence = [0, 1].map(|i| named(&report, &format!("agent{i}/influence_kl")));
                assert!(influence[0] > 0.0 && influence[1] > 0.0, "{case} {influence:?}");
            }
        }
        let arrays = kept.arrays().unwrap();
        assert_eq!(arrays, other.arrays().unwrap(), "{case}");
        let bytes = |algorithm: &dyn Algorithm| algorithm.snapshot().unwrap().to_bytes().unwrap();
        assert_eq!(bytes(kept.as_ref()), bytes(other.as_ref()), "{case}");
        let values = under(&arrays, "normalizer/value_").count();
        let expected = if alpha > 0.0 { 2 } else { usize::from(on_policy) };
        assert_eq!(values, expected, "{case}");
    }
}

#[test]
fn every_rule_and_critic_gives_the_same_bits_on_one_two_and_three_threads() {
    let recurrent = ON_POLICY.map(|rule| (rule, CriticCore::Gru));
    let all = [HAPPO, HAPPO_SHARED, MAPPO, MAPPO_SHARED, MADDPG, HASAC];
    for (rule, core) in all.map(|rule| (rule, CriticCore::Mlp)).into_iter().chain(recurrent) {
        let mut config = config(rule);
        config.critic.core = core;
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut algorithm = algorithm(&config);
                for iteration in 0..3 {
                    update(algorithm.as_mut(), &config, iteration);
                }
                algorithm.arrays().unwrap()
            })
        };
        let one = on(1);
        assert_eq!(one, on(2), "{rule:?} {core:?}");
        assert_eq!(one, on(3), "{rule:?} {core:?}");
    }
}

#[test]
fn weights_are_the_arrays_under_their_prefix_and_agents_with_shared_ones_act_equally() {
    for rule in [HAPPO, HAPPO_SHARED, MAPPO, MAPPO_SHARED, MADDPG, HASAC] {
        let config = config(rule);
        let mut algorithm = algorithm(&config);
        update(algorithm.as_mut(), &config, 0);
        let mut arrays = algorithm.arrays().unwrap();
        arrays.retain(|name, _| name.starts_with("weights/"));
        assert_eq!(algorithm.weights().unwrap(), arrays, "{rule:?}");
        let shared = under(&arrays, "weights/shared.").count() > 0;
        let own = under(&arrays, "weights/agent_1.").count() > 0;
        let expected = (rule.1 == Sharing::Shared, rule.1 == Sharing::Separate);
        assert_eq!((shared, own), expected, "{rule:?}");
        let agents = algorithm.snapshot().unwrap().agents;
        assert_eq!(agents.len(), 2);
        assert_eq!(agents[0].arrays() == agents[1].arrays(), shared, "{rule:?}");
    }
}

#[test]
fn surprise_of_weight_zero_gives_the_weights_of_a_replay_without_surprise() {
    for rule in [MADDPG, HASAC] {
        let mut config = config(rule);
        let batch = batch_for(&config);
        let trained = |rewards: &Relabelled<'_>, config: &TrainingConfig| {
            let mut algorithm = algorithm(config);
            algorithm.update(&batch, rewards, 0).unwrap();
            algorithm.weights().unwrap()
        };
        let without = trained(&plain(&batch), &config);
        for (alpha, is_equal) in [(0.0, true), (0.01, false)] {
            config.surprise.alpha = alpha;
            let surprise = fitted(&config, &batch);
            let with = trained(&surprise.relabel(&batch), &config);
            assert_eq!(with == without, is_equal, "{rule:?} {alpha}");
        }
    }
}

#[test]
fn rules_with_a_replay_do_not_learn_during_their_warm_up() {
    [MADDPG, HASAC].into_iter().for_each(assert_warm_up);
}

fn assert_warm_up(rule: (Rule, Sharing)) {
    let mut config = config(rule);
    config.maddpg.warm_up = 400;
    config.hasac.as_mut().unwrap().warm_up = 400;
    let mut algorithm = algorithm(&config);
    let start = algorithm.weights().unwrap();
    let head = |algorithm: &dyn Algorithm| algorithm.snapshot().unwrap().agents[1].spec().head();
    // 200 steps per iteration.
    for iteration in 0..2 {
        assert_eq!(head(algorithm.as_ref()), Head::Uniform { low: -1.0, high: 1.0 });
        update(algorithm.as_mut(), &config, iteration);
    }
    assert_eq!(algorithm.weights().unwrap(), start);
    let trained = head(algorithm.as_ref());
    assert!(matches!(trained, Head::Deterministic { .. } | Head::TanhGaussian { .. }));
    update(algorithm.as_mut(), &config, 2);
    assert_ne!(algorithm.weights().unwrap(), start);
}

#[test]
fn a_large_divergence_lowers_the_learning_rate_which_is_restored() {
    for rule in ON_POLICY {
        let mut config = config(rule);
        (config.update.minibatches, config.update.desired_kl) = (1, 1e-12);
        let (mut kept, mut other) = (algorithm(&config), algorithm(&config));
        let learning_rate = |algorithm: &mut dyn Algorithm, iteration| {
            named(&update(algorithm, &config, iteration), "agent1/learning_rate")
        };
        let first = learning_rate(kept.as_mut(), 0);
        other.restore(&kept.arrays().unwrap()).unwrap();
        let second = learning_rate(kept.as_mut(), 1);
        assert!(second < first, "{rule:?}: {first}, then {second}");
        assert_eq!(learning_rate(other.as_mut(), 1), second);
        assert_eq!(kept.arrays().unwrap(), other.arrays().unwrap());
    }
}

#[test]
fn a_posterior_of_vanishing_weight_gives_the_actors_of_happo() {
    let trained = |lambda: f64| {
        let mut config = config(HAPPO);
        config.influence.lambda = lambda;
        let mut algorithm = algorithm(&config);
        for iteration in 0..3 {
            update(algorithm.as_mut(), &config, iteration);
        }
        algorithm.arrays().unwrap()
    };
    // If the posterior's training changed the trunk, the actors would differ.
    let (plain, watched) = (trained(0.0), trained(1e-200));
    assert!(watched.len() > plain.len());
    for name in under(&plain, "weights/agent_") {
        assert_eq!(plain[name], watched[name], "{name}");
    }
}

#[test]
fn influence_raises_the_divergence_from_the_posteriors() {
    let divergence = |lambda: f64| {
        let mut config = config(HAPPO);
        (config.influence.lambda, config.update.learning_rate) = (lambda, 3e-3);
        let mut algorithm = algorithm(&config);
        let reports = (0..5).map(|iteration| update(algorithm.as_mut(), &config, iteration));
        named(&reports.last().unwrap(), "agent0/influence_kl")
    };
    let (pushed, left_alone) = (divergence(1.0), divergence(1e-9));
    assert!(pushed > 1.3 * left_alone, "{pushed} {left_alone}");
}

#[test]
fn a_learning_rate_of_zero_changes_no_actor_and_no_critic() {
    let mut config = config(HAPPO);
    config.influence.lambda = 0.0;
    let mut algorithm = algorithm(&config);
    let before = algorithm.weights().unwrap();
    algorithm.scale_learning_rates(0.0);
    update(algorithm.as_mut(), &config, 0);
    assert_eq!(algorithm.weights().unwrap(), before);
    algorithm.scale_learning_rates(1.0);
    update(algorithm.as_mut(), &config, 1);
    assert_ne!(algorithm.weights().unwrap(), before);
}
