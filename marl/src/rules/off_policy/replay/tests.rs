//! Targets and stored transitions, computed by hand.

use policy::arrays::Array;
use policy::randomness::{Draw, Purpose, RunSeed, generator};

use super::*;
use crate::config::{DensityKind, SurpriseConfig};
use crate::data::batch::{AgentBatch, AgentShape, Final};
use crate::sample;
use crate::state;

const HALF: NStepHorizon = NStepHorizon { gamma: 0.5, steps: 3 };

fn problem() -> Problem {
    let usual = sample::problem().agents.remove(0);
    let shape = AgentShape { observation: 1, action: 1, surprise_features: vec![0], ..usual };
    Problem { agents: vec![shape], state: 1 }
}

fn settings(capacity: usize) -> ReplaySettings {
    let (batch, n_step, warm_up, updates_per_step) = (1, 1, 0, 1.0);
    ReplaySettings { capacity, batch, n_step, warm_up, updates_per_step, terminal_states: true }
}

fn empty(capacity: usize) -> Replay {
    Replay::new(&problem(), settings(capacity))
}

/// `steps` steps of one environment from step `first`. The state is the step's number, the reward ten times it. `ends`
/// are `(step, TERMINATED or TRUNCATED)`. A final state is the number of the step before it plus a half.
fn stretch(first: usize, steps: usize, ends: &[(usize, u8)]) -> Batch {
    let numbers: Vec<f32> = (first..first + steps).map(|step| step as f32).collect();
    let ended = |kind: u8| (0..steps).map(|step| ends.contains(&(step, kind))).collect();
    let last = |step: usize| Final {
        step,
        environment: 0,
        state: vec![(first + step) as f32 + 0.5],
        observation: vec![vec![-1.0]],
    };
    let is_last = |step: &usize| *step + 1 == steps || ends.iter().any(|(end, _)| end == step);
    Batch {
        steps,
        environments: 1,
        agents: vec![AgentBatch {
            observation: numbers.clone(),
            action: numbers.clone(),
            log_prob: vec![0.0; steps],
            hidden: vec![],
        }],
        reward: numbers.iter().map(|number| 10.0 * number).collect(),
        state: numbers,
        terminated: ended(TERMINATED),
        truncated: ended(TRUNCATED),
        finals: (0..steps).filter(is_last).map(last).collect(),
    }
}

/// Reward, discount and bootstrap state of a row.
fn ahead(replay: &Replay, row: u64) -> (f64, f64, f32) {
    let target = replay.n_step_target(row, HALF);
    let reward = replay.discounted(&[target.rows], HALF.gamma, None).unwrap();
    (reward.0[0][0], target.discount, target.next[0])
}

#[test]
fn a_target_bootstraps_after_n_steps_from_a_truncation_and_never_from_a_termination() {
    let mut replay = empty(100);
    replay.add(&stretch(1, 8, &[(3, TRUNCATED), (5, TERMINATED)])).unwrap();
    // Step numbers 1 2 3 4| 5 6# 7 8, where | truncates and # terminates; row r is step r + 1.
    assert_eq!(ahead(&replay, 0), (10.0 + 10.0 + 7.5, 0.125, 4.0)); // three rewards, then step 4
    assert_eq!(ahead(&replay, 1), (20.0 + 15.0 + 10.0, 0.125, 4.5)); // ends with the truncation
    assert_eq!(ahead(&replay, 2), (30.0 + 20.0, 0.25, 4.5)); // two rewards before it
    assert_eq!(ahead(&replay, 3), (40.0, 0.5, 4.5));
    assert_eq!(ahead(&replay, 4), (50.0 + 30.0, 0.0, 6.5)); // terminated: the discount of what follows is 0
    assert_eq!(ahead(&replay, 6), (70.0 + 40.0, 0.25, 8.5)); // the newest step's true next state
}

#[test]
fn an_episode_that_is_cut_off_between_two_rollouts_ends_with_its_true_final_state() {
    let mut replay = empty(100);
    replay.cut_off(0);
    replay.add(&stretch(1, 2, &[])).unwrap();
    replay.cut_off(0);
    replay.add(&stretch(50, 3, &[])).unwrap();
    // Steps 1 2 | 50 51 52.
    assert_eq!(ahead(&replay, 0), (10.0 + 10.0, 0.25, 2.5));
    assert_eq!(ahead(&replay, 1), (20.0, 0.5, 2.5));
    assert_eq!(ahead(&replay, 2), (500.0 + 255.0 + 130.0, 0.125, 52.5));
}

/// Densities of the observations, which are numbers of steps.
fn surprise(alpha: f64) -> Surprise {
    let config = SurpriseConfig { alpha, density: DensityKind::DiagonalGaussian };
    Surprise::new(&config, &problem(), RunSeed(0)).unwrap()
}

/// Sampled rewards by the step that they begin with.
fn sampled(replay: &Replay, steps: usize, surprise: Option<&Surprise>) -> BTreeMap<u32, f64> {
    let mut rng = generator(RunSeed(1), Draw::of(Purpose::Replay));
    let (horizon, surprise) =
        (NStepHorizon { steps, ..HALF }, surprise.map(|surprise| (surprise, 0)));
    let sample = replay.sample(200, horizon, surprise, &mut rng).unwrap();
    let numbers = sample.now.state.iter().map(|&number| number as u32);
    numbers.zip(sample.reward[0].iter().copied()).collect()
}

#[test]
fn a_sampled_reward_contains_the_surprise_of_the_newest_density_alone() {
    let (first, second) = (stretch(1, 2, &[]), stretch(3, 4, &[]));
    let (mut replay, mut surprise) = (empty(100), surprise(2.0));
    // Each density is a Gaussian of its iteration's numbers: of 1 and 2 with mean 3/2 and variance 1/4, then of 3 to 6 with
    // mean 9/2 and variance 5/4. Without its constant, the log-density is -log(variance) / 2 - (x - mean)^2 / (2 variance).
    let by_hand = |x: f64, mean: f64, variance: f64| {
        10.0 * x + 2.0 * (-0.5 * libm::log(variance) - (x - mean) * (x - mean) / (2.0 * variance))
    };
    for (batch, numbers, (mean, variance)) in
        [(&first, 1..=2, (1.5, 0.25)), (&second, 1..=6, (4.5, 1.25))]
    {
        replay.add(batch).unwrap();
        surprise.refit(batch, 0).unwrap();
        // Rows are drawn many times, and twice from the same replay: nothing accumulates.
        let found = sampled(&replay, 1, Some(&surprise));
        assert_eq!(found, sampled(&replay, 1, Some(&surprise)));
        assert_eq!(found.keys().copied().collect::<Vec<_>>(), numbers.collect::<Vec<_>>());
        for (&x, reward) in &found {
            let expected = by_hand(f64::from(x), mean, variance);
            assert!((reward - expected).abs() < 1e-5, "{x}: {reward}, expected {expected}");
        }
    }
    // Of two steps, the second one's reward with surprise counts half.
    let (one, two) = (sampled(&replay, 1, Some(&surprise)), sampled(&replay, 2, Some(&surprise)));
    assert!((two[&2] - (one[&2] + 0.5 * one[&3])).abs() < 1e-12);
    // A step of the newest iteration has the reward with which rules without a replay learn from it.
    let relabelled = surprise.relabel(&second).rewards;
    assert_eq!(f64::from(relabelled[0][3]), one[&6]);
}

#[test]
fn the_bonus_of_a_batch_is_the_mean_surprise_of_its_steps() {
    let (mut replay, mut surprise) = (empty(100), surprise(2.0));
    let batch = stretch(3, 4, &[]);
    replay.add(&batch).unwrap();
    surprise.refit(&batch, 0).unwrap();
    let mut rng = generator(RunSeed(1), Draw::of(Purpose::Replay));
    let horizon = NStepHorizon { steps: 1, ..HALF };
    let sample = replay.sample(50, horizon, Some((&surprise, 0)), &mut rng).unwrap();
    // The reward of a step is ten times its number.
    let pairs = sample.reward[0].iter().zip(&sample.now.state);
    let sum: f64 = pairs.map(|(reward, &number)| reward - 10.0 * f64::from(number)).sum();
    assert!((sample.bonus[0] - sum / 50.0).abs() < 1e-9 && sum != 0.0, "{:?}", sample.bonus);
    assert!(replay.sample(50, horizon, None, &mut rng).unwrap().bonus.is_empty());
}

#[test]
fn targets_continue_into_the_next_iteration_once_it_is_stored() {
    let mut replay = empty(100);
    replay.add(&stretch(1, 2, &[])).unwrap();
    assert_eq!(ahead(&replay, 1), (20.0, 0.5, 2.5));
    replay.add(&stretch(3, 4, &[])).unwrap();
    assert_eq!(ahead(&replay, 1), (20.0 + 15.0 + 10.0, 0.125, 5.0));
}

#[test]
fn the_oldest_rows_and_their_final_states_are_removed_and_not_sampled() {
    let mut replay = empty(5);
    replay.add(&stretch(1, 4, &[(0, TRUNCATED), (3, TRUNCATED)])).unwrap();
    replay.add(&stretch(5, 4, &[])).unwrap();
    assert_eq!((replay.len(), replay.rows_added(), replay.oldest()), (5, 8, 3));
    assert_eq!(replay.finals.keys().copied().collect::<Vec<_>>(), [3, 7]);
    let mut rng = generator(RunSeed(1), Draw::of(Purpose::Replay));
    let mut drawn = replay.sample(200, HALF, None, &mut rng).unwrap().now.state;
    drawn.sort_by(f32::total_cmp);
    drawn.dedup();
    assert_eq!(drawn, [4.0, 5.0, 6.0, 7.0, 8.0]);
}

#[test]
fn a_stored_replay_with_too_few_rows_is_rejected() {
    let mut replay = empty(5);
    replay.add(&stretch(1, 4, &[(1, TRUNCATED)])).unwrap();
    let mut arrays = state::saved("", |visitor| replay.visit(visitor)).unwrap();
    arrays.insert("replay/ends".to_owned(), Array::U8 { shape: vec![1], data: vec![0] });
    let error = state::restored(&arrays, |visitor| replay.visit(visitor)).unwrap_err();
    assert!(error.to_string().contains("1 replay/ends"), "{error}");
}

#[test]
fn a_termination_without_final_state_has_its_own_and_is_rejected_by_a_rule_that_reads_the_final_one()
 {
    let omitting = ReplaySettings { terminal_states: false, ..settings(5) };
    let mut replay = Replay::new(&problem(), omitting);
    replay.add(&stretch(1, 4, &[(0, TRUNCATED), (2, TERMINATED)])).unwrap();
    assert_eq!(replay.finals.keys().copied().collect::<Vec<_>>(), [0, 3]);
    assert_eq!(ahead(&replay, 2), (30.0, 0.0, 3.0));
    let arrays = state::saved("", |visitor| replay.visit(visitor)).unwrap();
    state::restored(&arrays, |visitor| replay.visit(visitor)).unwrap();
    let error = state::restored(&arrays, |visitor| empty(5).visit(visitor)).unwrap_err();
    assert!(error.to_string().contains("replay/final_rows lacks 2, a termination"), "{error}");
}

#[test]
fn a_restored_replay_equals_the_stored_one() {
    let mut kept = empty(5);
    kept.add(&stretch(1, 4, &[(1, TRUNCATED)])).unwrap();
    kept.add(&stretch(5, 3, &[])).unwrap();
    let stored = |replay: &mut Replay| state::saved("", |visitor| replay.visit(visitor)).unwrap();
    let mut restored = empty(5);
    state::restored(&stored(&mut kept), |visitor| restored.visit(visitor)).unwrap();
    for replay in [&mut kept, &mut restored] {
        replay.add(&stretch(8, 2, &[(0, TERMINATED)])).unwrap();
    }
    assert_eq!(stored(&mut kept), stored(&mut restored));
}
