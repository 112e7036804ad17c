//! Whole updates: a small game is learnt, and results are reproducible.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "fixture/settings.rs"]
mod settings;

use marl::config::{CriticCore, Rule, Sharing};
use marl::{ActionKind, AgentBatch, AgentShape, Algorithm, Batch, Final, Problem, TrainingConfig};
use policy::{
    Array, CoreKind, Draw, NamedArrays, PolicyConfig, PolicySnapshot, Purpose, RunSeed, Scratch,
    generator, standard_normal,
};

const ENVIRONMENTS: usize = 40;
const STEPS: usize = 4;

fn policy() -> PolicyConfig {
    settings::policy(CoreKind::Gru)
}

fn config(lambda: f64) -> TrainingConfig {
    let mut config = settings::config(Rule::Happo);
    config.influence.lambda = lambda;
    config
}

fn problem() -> Problem {
    let shape = AgentShape {
        observation: 3,
        action: 1,
        action_range: (-1.0, 1.0),
        kind: ActionKind::Continuous,
        surprise_features: vec![0, 1],
    };
    Problem { agents: vec![shape.clone(), shape], state: 2 }
}

fn algorithm(lambda: f64, seed: u64) -> Box<dyn Algorithm> {
    marl::build(&config(lambda), &policy(), &problem(), RunSeed(seed)).unwrap()
}

/// Both agents observe the state `[x, y]` and their index.
fn observe(state: &[f32], agent: usize) -> Vec<f32> {
    vec![state[0], state[1], agent as f32]
}

/// The reward of a step is `1 - (a_0 + a_1 - x)^2`, a sum that no agent controls alone. The next state does not depend
/// on the actions. Every second step ends an episode.
fn play(snapshot: &PolicySnapshot, iteration: u64) -> Batch {
    play_with_ends(snapshot, iteration, [false, true, false, true])
}

/// As [`play`], but the second episode of the batch continues in the next one.
fn play_on(snapshot: &PolicySnapshot, iteration: u64) -> Batch {
    play_with_ends(snapshot, iteration, [false, true, false, false])
}

fn play_with_ends(snapshot: &PolicySnapshot, iteration: u64, ends: [bool; STEPS]) -> Batch {
    let draw = Draw::of(Purpose::Action).iteration(iteration);
    let mut rng = generator(RunSeed(9), draw);
    let mut batch = Batch {
        steps: STEPS,
        environments: ENVIRONMENTS,
        agents: vec![AgentBatch::default(); 2],
        ..Batch::default()
    };
    let mut hidden = [0, 1].map(|_| vec![0.0; ENVIRONMENTS * policy().hidden]);
    let mut scratch = Scratch::default();
    for (step, done) in ends.into_iter().enumerate() {
        if step % 2 == 0 {
            hidden.iter_mut().for_each(|hidden| hidden.fill(0.0));
        }
        let states: Vec<f32> =
            (0..ENVIRONMENTS * 2).map(|_| 0.5 * standard_normal(&mut rng)).collect();
        let mut sums = [0.0; ENVIRONMENTS];
        for (agent, policy) in snapshot.agents.iter().enumerate() {
            let data = &mut batch.agents[agent];
            let seen: Vec<f32> =
                states.chunks_exact(2).flat_map(|state| observe(state, agent)).collect();
            if step % 2 == 0 {
                data.hidden.extend(&hidden[agent]);
            }
            let mut mean = vec![0.0; ENVIRONMENTS];
            policy.forward(ENVIRONMENTS, &seen, &mut hidden[agent], &mut mean, &mut scratch);
            for (sum, mean) in sums.iter_mut().zip(mean) {
                let action = mean + policy.sigma()[0] * standard_normal(&mut rng);
                *sum += action;
                data.action.push(action);
                data.log_prob.push(0.0);
            }
            data.observation.extend(seen);
        }
        let error = |(sum, state): (&f32, &[f32])| (sum - state[0]) * (sum - state[0]);
        batch.reward.extend(sums.iter().zip(states.chunks_exact(2)).map(|pair| 1.0 - error(pair)));
        batch.terminated.extend(std::iter::repeat_n(done, ENVIRONMENTS));
        batch.truncated.extend(std::iter::repeat_n(false, ENVIRONMENTS));
        batch.state.extend(states);
        if done || step == STEPS - 1 {
            batch.finals.extend((0..ENVIRONMENTS).map(|environment| Final {
                step,
                environment,
                state: vec![0.0; 2],
                observation: vec![vec![0.0; 3]; 2],
            }));
        }
    }
    batch
}

fn update(algorithm: &mut dyn Algorithm, iteration: u64) -> f32 {
    let batch = play(&algorithm.snapshot().unwrap(), iteration);
    update_on(algorithm, &batch, iteration)
}

fn update_on(algorithm: &mut dyn Algorithm, batch: &Batch, iteration: u64) -> f32 {
    let rewards = vec![batch.reward.clone(); 2];
    algorithm.update(batch, &rewards, iteration).unwrap();
    batch.reward.iter().sum::<f32>() / batch.reward.len() as f32
}

/// Only the actors' weights.
fn actors(algorithm: &mut dyn Algorithm) -> NamedArrays {
    let arrays = algorithm.arrays().unwrap();
    arrays.into_iter().filter(|(name, _)| name.starts_with("weights/agent_")).collect()
}

#[test]
fn with_every_critic_agents_learn_and_continue_bit_for_bit_from_stored_state() {
    let (mlp, gru) = (CriticCore::Mlp, CriticCore::Gru);
    for (core, alpha, values) in [(mlp, 0.0, 1), (mlp, 0.01, 2), (gru, 0.01, 2), (gru, 0.0, 1)] {
        let mut config = config(0.0);
        (config.critic.core, config.surprise.alpha) = (core, alpha);
        let build = || marl::build(&config, &policy(), &problem(), RunSeed(1)).unwrap();
        let mut kept = build();
        let rewards: Vec<f32> = (0..60).map(|k| update(kept.as_mut(), k)).collect();
        assert!(rewards[55..].iter().sum::<f32>() / 5.0 > 0.74, "{core:?} {alpha}: {rewards:?}");
        let continued = |algorithm: &mut dyn Algorithm, iteration| {
            let batch = play_on(&algorithm.snapshot().unwrap(), iteration);
            update_on(algorithm, &batch, iteration);
        };
        continued(kept.as_mut(), 60);
        let stored = kept.arrays().unwrap();
        let carries = |(name, array): (&String, &Array)| {
            let Array::F32 { data, .. } = array else { return false };
            name.starts_with("memory/critic") && data.iter().any(|&value| value != 0.0)
        };
        assert_eq!(stored.iter().any(carries), core == gru, "{core:?} {alpha}");
        let of_values = stored.keys().filter(|name| name.starts_with("normalizer/value_"));
        assert_eq!(of_values.count(), values, "{core:?} {alpha}");
        let mut other = build();
        other.restore(&stored).unwrap();
        continued(kept.as_mut(), 61);
        continued(other.as_mut(), 61);
        assert_eq!(kept.arrays().unwrap(), other.arrays().unwrap(), "{core:?} {alpha}");
    }
}

#[test]
fn a_large_divergence_lowers_the_learning_rate_which_is_restored() {
    for (rule, parameters) in [
        (Rule::Happo, Sharing::Separate),
        (Rule::Happo, Sharing::Shared),
        (Rule::Mappo, Sharing::Separate),
        (Rule::Mappo, Sharing::Shared),
    ] {
        let mut config = config(0.0);
        (config.update.rule, config.update.parameters) = (rule, parameters);
        config.update.desired_kl = 1e-12;
        let build = || marl::build(&config, &policy(), &problem(), RunSeed(1)).unwrap();
        let (mut kept, mut other) = (build(), build());
        let learning_rate = |algorithm: &mut dyn Algorithm, iteration: u64| {
            let batch = play(&algorithm.snapshot().unwrap(), iteration);
            let rewards = vec![batch.reward.clone(); 2];
            let report = algorithm.update(&batch, &rewards, iteration).unwrap();
            report.iter().find(|(name, _)| name == "agent1/learning_rate").unwrap().1
        };
        let first = learning_rate(kept.as_mut(), 0);
        other.restore(&kept.arrays().unwrap()).unwrap();
        let second = learning_rate(kept.as_mut(), 1);
        assert!(second < first, "{rule:?} {parameters:?}: {first}, then {second}");
        assert_eq!(learning_rate(other.as_mut(), 1), second);
        assert_eq!(kept.arrays().unwrap(), other.arrays().unwrap());
    }
}

#[test]
fn missing_and_unknown_stored_arrays_are_rejected_by_name() {
    let mut algorithm = algorithm(0.01, 1);
    let mut arrays = algorithm.arrays().unwrap();
    let name = arrays.keys().next().unwrap().clone();
    let array = arrays.remove(&name).unwrap();
    let error = algorithm.restore(&arrays).unwrap_err().to_string();
    assert!(error.contains(name.rsplit('/').next().unwrap()), "{error}");
    arrays.insert(name, array.clone());
    arrays.insert("weights/agent_9.ghost".to_owned(), array);
    let error = algorithm.restore(&arrays).unwrap_err().to_string();
    assert!(error.contains("weights/agent_9.ghost"), "{error}");
}

#[test]
fn a_posterior_of_vanishing_weight_gives_the_actors_of_happo() {
    // If the posterior's training changed the trunk, the actors would differ.
    let (mut plain, mut watched) = (algorithm(0.0, 1), algorithm(1e-200, 1));
    for iteration in 0..3 {
        update(plain.as_mut(), iteration);
        update(watched.as_mut(), iteration);
    }
    assert_eq!(actors(plain.as_mut()), actors(watched.as_mut()));
    assert!(watched.arrays().unwrap().len() > plain.arrays().unwrap().len());
}

#[test]
fn the_influence_term_increases_the_divergence_from_the_posteriors() {
    let divergence = |lambda: f64| {
        let mut algorithm = algorithm(lambda, 1);
        let mut last = 0.0;
        for iteration in 0..5 {
            let batch = play(&algorithm.snapshot().unwrap(), iteration);
            let rewards = vec![batch.reward.clone(); 2];
            let report = algorithm.update(&batch, &rewards, iteration).unwrap();
            last = report.iter().find(|(name, _)| name == "agent0/influence_kl").unwrap().1;
        }
        last
    };
    let (pushed, left_alone) = (divergence(1.0), divergence(1e-9));
    assert!(pushed > 1.3 * left_alone, "{pushed} {left_alone}");
}

#[test]
fn equal_seeds_give_equal_weights_and_other_seeds_others() {
    let weights = |seed| {
        let mut algorithm = algorithm(0.01, seed);
        update(algorithm.as_mut(), 0);
        algorithm.weights().unwrap()
    };
    assert_eq!(weights(1), weights(1));
    assert_ne!(weights(1), weights(2));
}

#[test]
fn a_batch_with_a_nan_is_rejected_and_changes_nothing() {
    let mut algorithm = algorithm(0.01, 1);
    let before = algorithm.arrays().unwrap();
    let mut batch = play(&algorithm.snapshot().unwrap(), 0);
    let rewards = vec![batch.reward.clone(); 2];
    batch.agents[1].action[3] = f32::NAN;
    let error = algorithm.update(&batch, &rewards, 0).unwrap_err().to_string();
    assert_eq!(error, "batch.agents[1].action[3] is NaN");
    assert_eq!(algorithm.arrays().unwrap(), before);
}

#[test]
fn a_learning_rate_of_zero_changes_no_actor_and_no_critic() {
    let mut algorithm = algorithm(0.0, 1);
    let before = algorithm.weights().unwrap();
    algorithm.scale_learning_rates(0.0);
    update(algorithm.as_mut(), 0);
    assert_eq!(algorithm.weights().unwrap(), before);
    algorithm.scale_learning_rates(1.0);
    update(algorithm.as_mut(), 1);
    assert_ne!(algorithm.weights().unwrap(), before);
}
