//! Tests of every learning rule on one small game.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "fixture/settings.rs"]
mod settings;

use marl::config::{CriticCore, Rule, Sharing, StateNorm};
use marl::{ActionKind, AgentBatch, AgentShape, Algorithm, Batch, TrainingConfig, Final, Problem, Report};
use policy::{
    Array, CoreKind, Draw, Head, NamedArrays, PolicyConfig, PolicySnapshot, Purpose, RunSeed,
    Scratch, generator, standard_normal,
};

const ENVIRONMENTS: usize = 40;
const STEPS: usize = 4;
const RULES: [(Rule, Sharing); 5] = [
    (Rule::Happo, Sharing::Separate),
    (Rule::Happo, Sharing::Shared),
    (Rule::Mappo, Sharing::Separate),
    (Rule::Mappo, Sharing::Shared),
    (Rule::Maddpg, Sharing::Separate),
];

/// By default every second step ends an episode.
const ENDS: [bool; STEPS] = [false, true, false, true];

fn policy(core: CoreKind) -> PolicyConfig {
    PolicyConfig { width: 16, ..settings::policy(core) }
}

fn config((rule, parameters): (Rule, Sharing)) -> TrainingConfig {
    let mut config = settings::config(rule);
    config.update.parameters = parameters;
    config.update.minibatches = 2;
    config.critic.width = 32;
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

fn build(config: &TrainingConfig, core: CoreKind) -> Box<dyn Algorithm> {
    marl::build(config, &policy(core), &problem(), RunSeed(1)).unwrap()
}

fn algorithm(rule: (Rule, Sharing)) -> Box<dyn Algorithm> {
    build(&config(rule), CoreKind::Mlp)
}

/// The reward of a step is `1 - (a_0 + a_1 - x)^2`, a sum that no agent controls alone. The next state does not depend
/// on the actions. Episodes end after the steps `ends`, by termination in one half of the environments and by truncation
/// in the other. Actors with memory begin every second step with none. `draw` chooses an agent's action.
fn play_with(
    snapshot: &PolicySnapshot,
    iteration: u64,
    ends: [bool; STEPS],
    mut draw: impl FnMut(usize, &[f32], &mut [f32]),
) -> Batch {
    let mut rng = generator(RunSeed(9), Draw::of(Purpose::Reset).iteration(iteration));
    let mut hidden =
        [0, 1].map(|agent| vec![0.0; ENVIRONMENTS * snapshot.agents[agent].hidden_size()]);
    let mut batch = Batch {
        steps: STEPS,
        environments: ENVIRONMENTS,
        agents: vec![AgentBatch::default(); 2],
        ..Batch::default()
    };
    for (step, done) in ends.into_iter().enumerate() {
        let states: Vec<f32> =
            (0..ENVIRONMENTS * 2).map(|_| 0.5 * standard_normal(&mut rng)).collect();
        let mut sums = [0.0; ENVIRONMENTS];
        for (agent, policy) in snapshot.agents.iter().enumerate() {
            let data = &mut batch.agents[agent];
            let seen: Vec<f32> =
                states.chunks_exact(2).flat_map(|at| [at[0], at[1], agent as f32]).collect();
            let (hidden, mut mean) = (&mut hidden[agent], vec![0.0; ENVIRONMENTS]);
            if step % 2 == 0 {
                hidden.fill(0.0);
                data.hidden.extend(hidden.iter());
            }
            policy.forward(ENVIRONMENTS, &seen, hidden, &mut mean, &mut Scratch::default());
            for (sum, mean) in sums.iter_mut().zip(mean) {
                let mut action = [0.0];
                draw(agent, &[mean], &mut action);
                *sum += action[0];
                data.log_prob.push(policy.log_prob(&[mean], &action));
                data.action.extend(action);
            }
            data.observation.extend(seen);
        }
        let error = |(sum, state): (&f32, &[f32])| (sum - state[0]) * (sum - state[0]);
        batch.reward.extend(sums.iter().zip(states.chunks_exact(2)).map(|pair| 1.0 - error(pair)));
        batch.state.extend(states);
        end_episodes(&mut batch, step, done);
    }
    batch
}

fn end_episodes(batch: &mut Batch, step: usize, done: bool) {
    batch.terminated.extend((0..ENVIRONMENTS).map(|e| done && e % 2 == 0));
    batch.truncated.extend((0..ENVIRONMENTS).map(|e| done && e % 2 == 1));
    let (state, observation) = (vec![0.0; 2], vec![vec![0.0; 3]; 2]);
    let last = |environment| Final {
        step,
        environment,
        state: state.clone(),
        observation: observation.clone(),
    };
    batch.finals.extend((0..ENVIRONMENTS).filter(|_| done || step + 1 == STEPS).map(last));
}

/// Plays with actions drawn from the snapshot.
fn play(snapshot: &PolicySnapshot, iteration: u64, ends: [bool; STEPS]) -> Batch {
    let mut rng = generator(RunSeed(9), Draw::of(Purpose::Action).iteration(iteration));
    play_with(snapshot, iteration, ends, |agent, mean, action| {
        snapshot.agents[agent].draw(mean, &mut rng, action);
    })
}

/// Mean reward of the mean actions.
fn skill(algorithm: &dyn Algorithm) -> f32 {
    let choose = |_: usize, mean: &[f32], action: &mut [f32]| action.copy_from_slice(mean);
    let batch = play_with(&algorithm.snapshot().unwrap(), 1_000_000, ENDS, choose);
    batch.reward.iter().sum::<f32>() / batch.reward.len() as f32
}

fn update_after(algorithm: &mut dyn Algorithm, iteration: u64, ends: [bool; STEPS]) -> Report {
    let batch = play(&algorithm.snapshot().unwrap(), iteration, ends);
    let rewards = vec![batch.reward.clone(); 2];
    algorithm.update(&batch, &rewards, iteration).unwrap()
}

fn update(algorithm: &mut dyn Algorithm, iteration: u64) -> Report {
    update_after(algorithm, iteration, ENDS)
}

fn named(report: &Report, name: &str) -> f64 {
    report.iter().find(|(own, _)| own == name).unwrap().1
}

/// The names that begin with `prefix`.
fn under<'a>(arrays: &'a NamedArrays, prefix: &'a str) -> impl Iterator<Item = &'a String> {
    arrays.keys().filter(move |name| name.starts_with(prefix))
}

#[test]
fn sample_reuse_is_the_epochs_or_the_replays_draws_per_transition() {
    let epochs = config(RULES[0]).update.epochs as f64;
    // A tenth of a batch of 64 is 6.4.
    for (rule, reuse) in [(RULES[0], epochs), (RULES[2], epochs), (RULES[4], 6.4)] {
        let found = config(rule).sample_reuse();
        assert!((found - reuse).abs() < 1e-12, "{rule:?}: {found}, expected {reuse}");
    }
}

#[test]
fn every_rule_learns_a_sum_that_no_agent_controls_alone() {
    for rule in RULES {
        let mut algorithm = algorithm(rule);
        let before = skill(algorithm.as_ref());
        for iteration in 0..60 {
            update(algorithm.as_mut(), iteration);
        }
        let after = skill(algorithm.as_ref());
        // Agents that update one network in turn also undo part of the earlier agents' updates.
        let enough = if rule == (Rule::Happo, Sharing::Shared) { 0.9 } else { 0.95 };
        // Means of zero leave an error of x, whose variance is .25.
        assert!(before < 0.8 && after > enough, "{rule:?}: {before} {after}");
    }
}

#[test]
fn every_rule_and_critic_continues_bit_for_bit_from_its_stored_state_with_both_terms() {
    let (mlp, gru) = (CriticCore::Mlp, CriticCore::Gru);
    for (rule, core, alpha) in [
        (RULES[0], mlp, 0.0),
        (RULES[0], mlp, 0.01),
        (RULES[0], gru, 0.0),
        (RULES[0], gru, 0.01),
        (RULES[1], mlp, 0.0),
        (RULES[2], gru, 0.01),
        (RULES[3], mlp, 0.01),
        (RULES[4], mlp, 0.0),
    ] {
        let case = format!("{rule:?} {core:?} {alpha}");
        let (mut config, on_policy) = (config(rule), rule.0 != Rule::Maddpg);
        (config.critic.core, config.surprise.alpha) = (core, alpha);
        if on_policy {
            (config.critic.state_norm, config.influence.lambda) = (StateNorm::Running, 0.01);
        }
        let actors = if on_policy { CoreKind::Gru } else { CoreKind::Mlp };
        let (mut kept, mut other) = (build(&config, actors), build(&config, actors));
        // The second episode of a batch continues in the next one.
        let update = |algorithm: &mut dyn Algorithm, iteration| {
            update_after(algorithm, iteration, [false, true, false, false])
        };
        for iteration in 0..4 {
            update(kept.as_mut(), iteration);
        }
        update(other.as_mut(), 7);
        let stored = kept.arrays().unwrap();
        let carries = under(&stored, "memory/critic").any(|name| match &stored[name] {
            Array::F32 { data, .. } => data.iter().any(|&value| value != 0.0),
            _ => false,
        });
        assert_eq!(carries, core == gru, "{case}");
        other.restore(&stored).unwrap();
        let mut report = Report::new();
        for iteration in 4..20 {
            report = update(kept.as_mut(), iteration);
            update(other.as_mut(), iteration);
        }
        if on_policy {
            let values = under(&stored, "normalizer/value_").count();
            assert_eq!(values, if alpha > 0.0 { 2 } else { 1 }, "{case}");
            let influence = [0, 1].map(|i| named(&report, &format!("agent{i}/influence_kl")));
            assert!(influence[0] > 0.0 && influence[1] > 0.0, "{case} {influence:?}");
        }
        assert_eq!(kept.arrays().unwrap(), other.arrays().unwrap(), "{case}");
        let bytes = |algorithm: &dyn Algorithm| algorithm.snapshot().unwrap().to_bytes().unwrap();
        assert_eq!(bytes(kept.as_ref()), bytes(other.as_ref()), "{case}");
    }
}

#[test]
fn every_rule_and_critic_gives_the_same_bits_on_one_two_and_three_threads() {
    let recurrent = RULES.into_iter().filter(|(rule, _)| *rule != Rule::Maddpg);
    let cases = RULES.map(|rule| (rule, CriticCore::Mlp)).into_iter();
    for (rule, core) in cases.chain(recurrent.map(|rule| (rule, CriticCore::Gru))) {
        let mut config = config(rule);
        config.critic.core = core;
        config.validate().unwrap();
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut algorithm = build(&config, CoreKind::Mlp);
                for iteration in 0..5 {
                    update(algorithm.as_mut(), iteration);
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
    for rule in RULES {
        let mut algorithm = algorithm(rule);
        update(algorithm.as_mut(), 0);
        let mut arrays = algorithm.arrays().unwrap();
        arrays.retain(|name, _| name.starts_with("weights/"));
        assert_eq!(algorithm.weights().unwrap(), arrays);
        let shared = under(&arrays, "weights/shared.").count() > 0;
        let own = under(&arrays, "weights/agent_1.").count() > 0;
        assert_eq!((shared, own), (rule.1 == Sharing::Shared, rule.1 == Sharing::Separate));
        let agents = algorithm.snapshot().unwrap().agents;
        assert_eq!(agents.len(), 2);
        assert_eq!(agents[0].arrays() == agents[1].arrays(), shared, "{rule:?}");
    }
}

#[test]
fn maddpg_does_not_learn_during_its_warm_up() {
    let mut algorithm = algorithm((Rule::Maddpg, Sharing::Separate));
    let start = algorithm.weights().unwrap();
    let head = |algorithm: &dyn Algorithm| algorithm.snapshot().unwrap().agents[1].spec().head();
    // 160 steps per iteration, a warm-up of 320.
    for iteration in 0..2 {
        assert_eq!(head(algorithm.as_ref()), Head::Uniform { low: -1.0, high: 1.0 });
        update(algorithm.as_mut(), iteration);
    }
    assert_eq!(algorithm.weights().unwrap(), start);
    assert!(matches!(head(algorithm.as_ref()), Head::Deterministic { .. }));
    update(algorithm.as_mut(), 2);
    assert_ne!(algorithm.weights().unwrap(), start);
}

#[test]
fn a_large_divergence_lowers_the_learning_rate_which_is_restored() {
    for rule in RULES.into_iter().filter(|(rule, _)| *rule != Rule::Maddpg) {
        let mut config = config(rule);
        (config.update.minibatches, config.update.desired_kl) = (1, 1e-12);
        let (mut kept, mut other) = (build(&config, CoreKind::Gru), build(&config, CoreKind::Gru));
        let learning_rate = |algorithm: &mut dyn Algorithm, iteration: u64| {
            named(&update(algorithm, iteration), "agent1/learning_rate")
        };
        let first = learning_rate(kept.as_mut(), 0);
        other.restore(&kept.arrays().unwrap()).unwrap();
        let second = learning_rate(kept.as_mut(), 1);
        assert!(second < first, "{rule:?}: {first}, then {second}");
        assert_eq!(learning_rate(other.as_mut(), 1), second);
        assert_eq!(kept.arrays().unwrap(), other.arrays().unwrap());
    }
}

fn happo(lambda: f64) -> Box<dyn Algorithm> {
    let mut config = settings::config(Rule::Happo);
    config.influence.lambda = lambda;
    build(&config, CoreKind::Gru)
}

#[test]
fn a_posterior_of_vanishing_weight_gives_the_actors_of_happo() {
    // If the posterior's training changed the trunk, the actors would differ.
    let (mut plain, mut watched) = (happo(0.0), happo(1e-200));
    for iteration in 0..3 {
        update(plain.as_mut(), iteration);
        update(watched.as_mut(), iteration);
    }
    let (plain, watched) = (plain.arrays().unwrap(), watched.arrays().unwrap());
    for name in under(&plain, "weights/agent_") {
        assert_eq!(plain[name], watched[name], "{name}");
    }
    assert!(watched.len() > plain.len());
}

#[test]
fn the_influence_term_increases_the_divergence_from_the_posteriors() {
    let divergence = |lambda: f64| {
        let mut algorithm = happo(lambda);
        let mut report = Report::new();
        for iteration in 0..5 {
            report = update(algorithm.as_mut(), iteration);
        }
        named(&report, "agent0/influence_kl")
    };
    let (pushed, left_alone) = (divergence(1.0), divergence(1e-9));
    assert!(pushed > 1.3 * left_alone, "{pushed} {left_alone}");
}

#[test]
fn a_learning_rate_of_zero_changes_no_actor_and_no_critic() {
    let mut algorithm = happo(0.0);
    let before = algorithm.weights().unwrap();
    algorithm.scale_learning_rates(0.0);
    update(algorithm.as_mut(), 0);
    assert_eq!(algorithm.weights().unwrap(), before);
    algorithm.scale_learning_rates(1.0);
    update(algorithm.as_mut(), 1);
    assert_ne!(algorithm.weights().unwrap(), before);
}

#[test]
fn other_seeds_give_other_weights() {
    let weights = |seed| {
        let config = config(RULES[0]);
        let built = marl::build(&config, &policy(CoreKind::Gru), &problem(), RunSeed(seed));
        built.unwrap().weights().unwrap()
    };
    assert_ne!(weights(1), weights(2));
}
