//! Tests of every learning rule on one small game, with actors without memory.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "fixture/settings.rs"]
mod settings;

use marl::config::{CriticCore, Rule, Sharing, StateNorm};
use marl::{ActionKind, AgentBatch, AgentShape, Algorithm, Batch, Final, Problem, TrainingConfig};
use policy::{
    CoreKind, Draw, Head, PolicyConfig, PolicySnapshot, Purpose, RunSeed, Scratch, generator,
    standard_normal,
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

fn policy() -> PolicyConfig {
    PolicyConfig { width: 16, ..settings::policy(CoreKind::Mlp) }
}

fn config(rule: Rule, parameters: Sharing) -> TrainingConfig {
    let mut config = settings::config(rule);
    config.update.parameters = parameters;
    config.update.minibatches = 2;
    config.critic.width = 32;
    config
}

#[test]
fn sample_reuse_is_the_epochs_or_the_replays_draws_per_transition() {
    let epochs = config(Rule::Happo, Sharing::Separate).update.epochs as f64;
    for (rule, reuse) in [(Rule::Happo, epochs), (Rule::Mappo, epochs), (Rule::Maddpg, 6.4)] {
        let found = config(rule, Sharing::Separate).sample_reuse();
        assert!(
            (found - reuse).abs() < 1e-12,
            "{rule:?}: {found}, a tenth of a batch of 64 is 6.4"
        );
    }
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

fn algorithm(rule: (Rule, Sharing)) -> Box<dyn Algorithm> {
    marl::build(&config(rule.0, rule.1), &policy(), &problem(), RunSeed(1)).unwrap()
}

/// The reward of a step is `1 - (a_0 + a_1 - x)^2`, a sum that no agent controls alone. The next state does not depend
/// on the actions. Every second step ends an episode, by termination in one half of the environments and by truncation
/// in the other. `draw` chooses an agent's action.
fn play_with(
    snapshot: &PolicySnapshot,
    iteration: u64,
    mut draw: impl FnMut(usize, &[f32], &mut [f32]),
) -> Batch {
    let mut rng = generator(RunSeed(9), Draw::of(Purpose::Reset).iteration(iteration));
    let mut batch = Batch {
        steps: STEPS,
        environments: ENVIRONMENTS,
        agents: vec![AgentBatch::default(); 2],
        ..Batch::default()
    };
    for step in 0..STEPS {
        let states: Vec<f32> =
            (0..ENVIRONMENTS * 2).map(|_| 0.5 * standard_normal(&mut rng)).collect();
        let mut sums = [0.0; ENVIRONMENTS];
        for (agent, policy) in snapshot.agents.iter().enumerate() {
            let data = &mut batch.agents[agent];
            let seen: Vec<f32> =
                states.chunks_exact(2).flat_map(|at| [at[0], at[1], agent as f32]).collect();
            let mut mean = vec![0.0; ENVIRONMENTS];
            policy.forward(ENVIRONMENTS, &seen, &mut [], &mut mean, &mut Scratch::default());
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
        end_episodes(&mut batch, step);
    }
    batch
}

fn end_episodes(batch: &mut Batch, step: usize) {
    let done = step % 2 == 1;
    batch.terminated.extend((0..ENVIRONMENTS).map(|e| done && e % 2 == 0));
    batch.truncated.extend((0..ENVIRONMENTS).map(|e| done && e % 2 == 1));
    let (state, observation) = (vec![0.0; 2], vec![vec![0.0; 3]; 2]);
    let last = |environment| Final {
        step,
        environment,
        state: state.clone(),
        observation: observation.clone(),
    };
    batch.finals.extend((0..ENVIRONMENTS).filter(|_| done).map(last));
}

/// Plays with actions drawn from the snapshot.
fn play(snapshot: &PolicySnapshot, iteration: u64) -> Batch {
    let mut rng = generator(RunSeed(9), Draw::of(Purpose::Action).iteration(iteration));
    play_with(snapshot, iteration, |agent, mean, action| {
        snapshot.agents[agent].draw(mean, &mut rng, action);
    })
}

/// Mean reward of the mean actions.
fn skill(algorithm: &dyn Algorithm) -> f32 {
    let snapshot = algorithm.snapshot().unwrap();
    let batch = play_with(&snapshot, 1_000_000, |_, mean, action| action.copy_from_slice(mean));
    batch.reward.iter().sum::<f32>() / batch.reward.len() as f32
}

fn update(algorithm: &mut dyn Algorithm, iteration: u64) {
    let batch = play(&algorithm.snapshot().unwrap(), iteration);
    let rewards = vec![batch.reward.clone(); 2];
    algorithm.update(&batch, &rewards, iteration).unwrap();
}

#[test]
fn every_rule_learns_a_sum_that_no_agent_controls_alone() {
    for rule in RULES {
        let mut algorithm = algorithm(rule);
        let before = skill(algorithm.as_ref());
        (0..60).for_each(|iteration| update(algorithm.as_mut(), iteration));
        let after = skill(algorithm.as_ref());
        // Agents that update one network in turn also undo part of the earlier agents' updates.
        let enough = if rule == (Rule::Happo, Sharing::Shared) { 0.9 } else { 0.95 };
        // Means of zero leave an error of x, whose variance is .25.
        assert!(before < 0.8 && after > enough, "{rule:?}: {before} {after}");
    }
}

#[test]
fn mappo_supports_both_terms_by_configuration() {
    for sharing in [Sharing::Separate, Sharing::Shared] {
        let mut config = config(Rule::Mappo, sharing);
        config.influence.lambda = 0.01;
        let mut algorithm = marl::build(&config, &policy(), &problem(), RunSeed(1)).unwrap();
        let batch = play(&algorithm.snapshot().unwrap(), 0);
        // With surprise, rewards differ from agent to agent.
        let rewards = vec![batch.reward.clone(), batch.reward.iter().map(|r| 0.9 * r).collect()];
        let report = algorithm.update(&batch, &rewards, 0).unwrap();
        let named = |name: &str| report.iter().find(|(own, _)| own == name).unwrap().1;
        assert!(named("agent0/influence_kl") > 0.0 && named("agent1/influence_kl") > 0.0);
        assert!(algorithm.arrays().unwrap().keys().any(|name| name.contains("posterior")));
    }
}

#[test]
fn every_rule_continues_bit_for_bit_from_its_stored_state() {
    for rule in RULES {
        let mut config = config(rule.0, rule.1);
        if rule.0 != Rule::Maddpg {
            (config.critic.state_norm, config.influence.lambda) = (StateNorm::Running, 0.01);
        }
        let build = || marl::build(&config, &policy(), &problem(), RunSeed(1)).unwrap();
        let (mut kept, mut other) = (build(), build());
        (0..4).for_each(|iteration| update(kept.as_mut(), iteration));
        update(other.as_mut(), 7);
        other.restore(&kept.arrays().unwrap()).unwrap();
        for iteration in 4..20 {
            update(kept.as_mut(), iteration);
            update(other.as_mut(), iteration);
        }
        assert_eq!(kept.arrays().unwrap(), other.arrays().unwrap(), "{rule:?}");
        let bytes = |algorithm: &dyn Algorithm| algorithm.snapshot().unwrap().to_bytes().unwrap();
        assert_eq!(bytes(kept.as_ref()), bytes(other.as_ref()), "{rule:?}");
    }
}

#[test]
fn every_rule_gives_the_same_bits_on_one_two_and_three_threads() {
    for rule in RULES {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut algorithm = algorithm(rule);
                (0..5).for_each(|iteration| update(algorithm.as_mut(), iteration));
                algorithm.arrays().unwrap()
            })
        };
        let one = on(1);
        assert_eq!(one, on(2), "{rule:?}");
        assert_eq!(one, on(3), "{rule:?}");
    }
}

#[test]
fn recurrent_critics_give_the_same_bits_on_one_two_and_three_threads_with_any_rule() {
    for rule in RULES.into_iter().filter(|(rule, _)| *rule != Rule::Maddpg) {
        let mut config = config(rule.0, rule.1);
        config.critic.core = CriticCore::Gru;
        config.validate().unwrap();
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut algorithm =
                    marl::build(&config, &policy(), &problem(), RunSeed(1)).unwrap();
                (0..5).for_each(|iteration| update(algorithm.as_mut(), iteration));
                algorithm.arrays().unwrap()
            })
        };
        let one = on(1);
        assert!(one.keys().any(|name| name.starts_with("memory/critic")));
        assert_eq!(one, on(2), "{rule:?}");
        assert_eq!(one, on(3), "{rule:?}");
    }
}

#[test]
fn weights_are_the_arrays_under_their_prefix() {
    for rule in RULES {
        let mut algorithm = algorithm(rule);
        let mut arrays = algorithm.arrays().unwrap();
        arrays.retain(|name, _| name.starts_with("weights/"));
        assert_eq!(algorithm.weights().unwrap(), arrays);
        let shared = arrays.keys().any(|name| name.starts_with("weights/shared."));
        let own = arrays.keys().any(|name| name.starts_with("weights/agent_1."));
        assert_eq!((shared, own), (rule.1 == Sharing::Shared, rule.1 == Sharing::Separate));
    }
}

#[test]
fn agents_with_shared_parameters_act_equally() {
    let mut algorithm = algorithm((Rule::Mappo, Sharing::Shared));
    update(algorithm.as_mut(), 0);
    let agents = algorithm.snapshot().unwrap().agents;
    assert_eq!(agents.len(), 2);
    assert_eq!(agents[0].arrays(), agents[1].arrays());
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
