//! Agents that share noise: the learner computes the actors' signals, and influence by the loadings agrees with its
//! estimate.

use std::sync::Arc;

use policy::{Draw, Noise, Purpose, Scratch, generator};

use super::super::agent::fit_posteriors;
use super::super::ascent::maximise;
use super::*;
use crate::config::{Estimator, TrainingConfig};
use crate::data::batch::{ActionKind, AgentBatch, AgentShape, Final, Problem};
use crate::optimisation::tests::meets_finite_differences;
use crate::rules::tests::plain;

const SEED: RunSeed = RunSeed(3);
const ITERATION: u64 = 4;
const STEPS: usize = 20;
const ENVIRONMENTS: usize = 500;
const ROWS: usize = STEPS * ENVIRONMENTS;

fn config(estimator: Estimator) -> TrainingConfig {
    let mut config = sample::config();
    (config.update.entropy, config.update.clip) = (0.0, 10.0);
    let influence = &mut config.influence;
    influence.estimator = estimator;
    (influence.encoder, influence.hidden, influence.lambda) = (16, 16, 1.0);
    (influence.epochs, influence.minibatches, influence.learning_rate) = (10, 20, 2e-2);
    config
}

/// Two agents with one action number each, whose noise has this correlation with the signal; 0: learnt.
fn pair(config: &TrainingConfig, loading: f32) -> Vec<Agent> {
    pair_of(config, loading, 1)
}

/// Two agents with actions of this size.
fn pair_of(config: &TrainingConfig, loading: f32, action: usize) -> Vec<Agent> {
    let policy = PolicyConfig {
        core: CoreKind::Mlp,
        width: 8,
        backpropagation_steps: 5,
        noise: Some(Noise::Shared),
        noise_loading: Some(loading),
        noise_hold: Some(2),
        ..sample::policy()
    };
    let shape = AgentShape {
        observation: 2,
        action,
        action_range: (-1.0, 1.0),
        kind: ActionKind::Continuous,
        surprise_features: vec![0, 1],
    };
    let problem = Problem { agents: vec![shape.clone(), shape], state: 1 };
    (0..2).map(|index| Agent::new(config, &policy, &problem, SEED, index).unwrap()).collect()
}

/// What actors with the agents' policies do in an iteration. Observations are constant.
fn played(agents: &[Agent]) -> Batch {
    let last = |environment| Final { step: STEPS - 1, environment, ..Final::default() };
    let mut batch = Batch {
        steps: STEPS,
        environments: ENVIRONMENTS,
        agents: vec![AgentBatch::default(); agents.len()],
        terminated: vec![false; ROWS],
        truncated: vec![false; ROWS],
        finals: (0..ENVIRONMENTS).map(last).collect(),
        ..Batch::default()
    };
    for (index, agent) in agents.iter().enumerate() {
        let (policy, data) = (agent.policy().unwrap(), &mut batch.agents[index]);
        for row in 0..ROWS {
            let actions = policy.action_size();
            let (mut output, mut action) = (vec![0.0; actions], vec![0.0; actions]);
            policy.forward(1, &[1.0, -0.5], &mut [], &mut output, &mut Scratch::default());
            let (step, environment) = ((row / ENVIRONMENTS) as u32, (row % ENVIRONMENTS) as u32);
            let key = Draw::of_action(ITERATION, environment, step, index as u32);
            policy.add_shared_noise(SEED, key, &mut output);
            policy.draw(&output, &mut generator(SEED, key), &mut action);
            data.observation.extend([1.0, -0.5]);
            data.log_prob.push(policy.log_prob(&output, &action));
            data.action.extend(action);
        }
    }
    batch
}

/// The actors' rollout data with equal advantages, as of an iteration.
fn gathered(agents: &[Agent], batch: &Batch, iteration: u64) -> Vec<Experience> {
    let advantages = vec![vec![0.0; ROWS]; agents.len()];
    gather(agents, batch, ChunkLayout::of(batch, 5), &advantages, (SEED, iteration)).unwrap()
}

#[test]
fn the_learner_computes_the_actors_log_densities_from_the_iterations_signals() {
    for share in [1.0, 0.5] {
        let mut agents = pair(&config(Estimator::Exact), 0.9);
        for agent in &mut agents {
            agent.network = Arc::new(agent.network.with_noise_share(share));
        }
        let batch = played(&agents);
        let layout = ChunkLayout::of(&batch, 5);
        let largest_difference = |iteration, index: usize| {
            let found = gathered(&agents, &batch, iteration);
            let sent = layout.chunked(&batch.agents[index].log_prob, 1);
            let pairs = found[index].log_prob.iter().zip(sent);
            pairs.map(|(found, sent)| (found - f64::from(sent)).abs()).fold(0.0, f64::max)
        };
        assert!(largest_difference(ITERATION, 0) < 1e-4 && largest_difference(ITERATION, 1) < 1e-4);
        assert!(largest_difference(ITERATION + 1, 0) > 1.0);
    }
}

#[test]
fn an_update_with_a_share_of_zero_is_that_of_independent_noise() {
    let mut config = config(Estimator::VariationalKl);
    config.influence.lambda = 0.0;
    let (problem, batch) = (sample::problem(), sample::batch());
    let updated = |loading: Option<f32>, noise: Option<f64>| {
        let shared = noise.map(|_| Noise::Shared);
        let policy = PolicyConfig { noise: shared, noise_loading: loading, ..sample::policy() };
        let mut algorithm = crate::build(&config, &policy, &problem, SEED).unwrap();
        algorithm.scale_noise(noise.unwrap_or(1.0));
        algorithm.update(&batch, &plain(&batch), ITERATION).unwrap();
        let mut arrays = algorithm.arrays().unwrap();
        arrays.retain(|name, _| !name.contains("head.loading"));
        arrays
    };
    let independent = updated(None, None);
    for loading in [Some(0.7), None] {
        assert_eq!(updated(loading, Some(0.0)), independent, "{loading:?}");
        let [half, whole] = [0.5, 1.0].map(|share| updated(loading, Some(share)));
        assert!(half != independent && whole != independent && half != whole, "{loading:?}");
    }
}

#[test]
fn a_learnt_posterior_estimates_the_exact_information_to_a_twentieth_of_a_nat() {
    let mut agents = pair(&config(Estimator::VariationalKl), 0.9);
    let batch = played(&agents);
    let experience = gathered(&agents, &batch, ITERATION);
    let exact = Influence::exact(0, &experience).mi_estimate.unwrap();
    // -1/2 log(1 - 0.9^2 0.9^2)
    assert!((exact - 0.533_702).abs() < 1e-5, "{exact}");
    let fitted = fit_posteriors(&mut agents, &experience, SEED, ITERATION).unwrap();
    let estimate = fitted[0].mi_estimate.unwrap();
    assert!((estimate - exact).abs() < 0.05, "{estimate}, exact {exact}");
}

#[test]
fn the_estimate_for_actions_of_several_numbers_is_that_of_the_whole_action() {
    let mut agents = pair_of(&config(Estimator::VariationalKl), 0.72, 3);
    let batch = played(&agents);
    let experience = gathered(&agents, &batch, ITERATION);
    let exact = Influence::exact(0, &experience).mi_estimate.unwrap();
    // P = 3 x 0.5184 / 0.4816 for each agent: log(1 + P) - 1/2 log(1 + 2 P)
    assert!((exact - 0.437_3).abs() < 1e-3, "{exact}");
    let fitted = fit_posteriors(&mut agents, &experience, SEED, ITERATION).unwrap();
    let estimate = fitted[0].mi_estimate.unwrap();
    assert!((estimate - exact).abs() < 0.05, "{estimate}, exact {exact}");
    let (posterior, policy) = fitted[0].held_out.unwrap();
    assert!((policy - posterior - estimate).abs() < 1e-9);
    // A second head that has learnt nothing.
    let mut literal = config(Estimator::VariationalKl);
    literal.influence.q_training = crate::config::QTraining::Shared;
    let mut agents = pair_of(&literal, 0.72, 3);
    let fitted = fit_posteriors(&mut agents, &experience, SEED, ITERATION).unwrap();
    let estimate = fitted[0].mi_estimate.unwrap();
    assert!(estimate.abs() < 0.05, "{estimate}");
}

#[test]
fn with_equal_advantages_only_exact_influence_changes_the_loadings_and_raises_them() {
    for (lambda, rises) in [(1.0, true), (0.0, false)] {
        let mut config = config(Estimator::Exact);
        config.influence.lambda = lambda;
        let mut agents = pair(&config, 0.0);
        let batch = played(&agents);
        let experience = gathered(&agents, &batch, ITERATION);
        let influence = fit_posteriors(&mut agents, &experience, SEED, ITERATION).unwrap();
        let agent = &mut agents[0];
        let loading = |agent: &Agent| agent.policy().unwrap().mean_loading().unwrap();
        let before = loading(agent);
        let inputs = AgentInputs { experience: &experience[0], influence: &influence[0] };
        let key = (SEED, Draw::of(Purpose::Minibatch));
        maximise(agent, inputs, &vec![1.0; ROWS], key).unwrap();
        assert!((before - 0.094_685).abs() < 1e-5, "{before}");
        assert_eq!(loading(agent) > before, rises, "{before} {}", loading(agent));
        assert!(rises || loading(agent) == before);
    }
}

#[test]
fn the_gradient_of_the_loadings_and_deviations_matches_finite_differences() {
    let policy = PolicyConfig {
        head_gain: 1.0,
        noise: Some(Noise::Shared),
        noise_size: Some(2),
        ..sample::policy()
    };
    let (config, problem, batch) = (config(Estimator::Exact), sample::problem(), sample::batch());
    let agent = |index| Agent::new(&config, &policy, &problem, SEED, index).unwrap();
    let mut agents = vec![agent(0), agent(1)];
    let advantages = vec![batch.reward.iter().map(|&r| f64::from(r)).collect::<Vec<_>>(); 2];
    let experience = gather(&agents, &batch, layout(&batch), &advantages, (SEED, 0)).unwrap();
    let influence = fit_posteriors(&mut agents, &experience, SEED, 0).unwrap();
    let inputs = AgentInputs { experience: &experience[0], influence: &influence[0] };
    let factor = vec![1.0; batch.rows()];
    let columns: Vec<usize> = (0..layout(&batch).chunks).collect();
    let agent = &agents[0];
    let loss = || gradient(agent, inputs, &factor, &columns).unwrap().0.loss;
    let found = gradient(agent, inputs, &factor, &columns).unwrap().1;
    for (name, elements) in [("head.loading", 6), ("head.log_std", 3)] {
        let span = agent.trainable.spans().iter().find(|span| span.name == name).unwrap();
        let of = (&agent.trainable.vars()[span.var], found.0[span.var].as_slice());
        let significant = meets_finite_differences(&loss, of, 0..elements, (2e-3, 5e-3));
        assert!(2 * significant > elements, "{name}: {significant} have a slope");
    }
}
