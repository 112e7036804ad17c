//! Tests of the signal game: its optimum, its return without communication, states, rejected inputs.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde_json::json;
use sim::{EnvironmentBatch, Outcome};

const STEPS: usize = 50;

fn game(count: usize) -> Box<dyn EnvironmentBatch> {
    let observation = json!({
        "mode": "full_id", "norm": "none", "nearest": 1, "globals": "hidden", "contact_forces": "absent",
    });
    let task = json!({"task": "signal-2x1", "observation": observation});
    sim::environments(&serde_json::from_value(task).unwrap(), count).unwrap()
}

fn reset(game: &mut dyn EnvironmentBatch, environment: usize, seed: u64) {
    let key = ChaCha8Rng::seed_from_u64(seed).get_seed();
    game.reset(environment, 3, STEPS as u32, key).unwrap();
}

/// Target and leg, as the sender observes them.
fn sent(game: &dyn EnvironmentBatch) -> [f32; 2] {
    let mut out = [0.0; 2];
    game.observation(0, 0, &mut out);
    out
}

/// Position of the leg, as the receiver observes it.
fn received(game: &dyn EnvironmentBatch) -> f32 {
    let mut out = [0.0];
    game.observation(0, 1, &mut out);
    out[0]
}

/// Return of an episode; `act` maps target and received position to both actions.
fn played(seed: u64, act: impl Fn(f32, f32) -> [f32; 2]) -> f64 {
    let mut game = game(1);
    reset(&mut *game, 0, seed);
    let mut total = 0.0;
    for step in 0..STEPS {
        let mut outcome = [Outcome::default()];
        let actions = act(sent(&*game)[0], received(&*game));
        game.step(&actions, &mut outcome).unwrap();
        assert_eq!(outcome[0].truncated, step + 1 == STEPS);
        total += f64::from(outcome[0].reward);
    }
    total
}

#[test]
fn a_sender_that_moves_to_the_target_and_a_receiver_that_repeats_it_have_a_return_of_50() {
    for seed in 0..5 {
        assert_eq!(played(seed, |target, leg| [target, leg]), 50.0);
        assert_eq!(played(seed, |target, leg| [-target, -leg]), 50.0);
    }
}

#[test]
fn without_information_the_best_mean_return_is_1_plus_49_times_two_thirds() {
    let mean = |action: f32| {
        (0..400).map(|seed| played(seed, |target, _| [target, action])).sum::<f64>() / 400.0
    };
    // A step's squared target has variance 4/45, so the mean over 400 x 49 has a standard error of 0.1.
    assert!((mean(0.0) - (1.0 + 49.0 * 2.0 / 3.0)).abs() < 0.5);
    assert!(mean(0.2) < mean(0.0) && mean(-0.2) < mean(0.0));
}

#[test]
fn actions_beyond_the_range_count_as_its_ends() {
    let mut game = game(1);
    reset(&mut *game, 0, 1);
    let mut outcome = [Outcome::default()];
    game.step(&[7.0, -3.0], &mut outcome).unwrap();
    assert_eq!((outcome[0].reward, received(&*game)), (0.0, 1.0));
}

#[test]
fn a_restored_game_continues_bit_for_bit() {
    let (mut straight, mut cut) = (game(2), game(2));
    (0..2).for_each(|e| reset(&mut *straight, e, e as u64));
    let mut outcomes = [[Outcome::default(); 2]; 2];
    for step in 0..STEPS {
        for environment in 0..2 {
            cut.restore(environment, &straight.encode(environment).unwrap()).unwrap();
        }
        let actions: Vec<f32> = (0..4).map(|i| ((step * 5 + i) % 7) as f32 / 3.0 - 1.0).collect();
        straight.step(&actions, &mut outcomes[0]).unwrap();
        cut.step(&actions, &mut outcomes[1]).unwrap();
        assert_eq!(outcomes[0], outcomes[1]);
        assert_eq!(straight.encode_all().unwrap(), cut.encode_all().unwrap());
        let mut states = [[0.0; 3]; 2];
        straight.state(1, &mut states[0]);
        cut.state(1, &mut states[1]);
        assert_eq!(states[0], states[1]);
    }
}

#[test]
fn an_action_that_is_not_finite_is_rejected_without_a_step() {
    let mut game = game(1);
    reset(&mut *game, 0, 1);
    let before = game.encode(0).unwrap();
    let error = game.step(&[0.5, f32::NAN], &mut [Outcome::default()]).unwrap_err();
    let line = "the action of agent 1 in environment 0 is NaN at index 0; it must be a number from -1e6 to 1e6";
    assert_eq!(error.to_string(), line);
    assert_eq!(game.encode(0).unwrap(), before);
}

#[test]
fn the_receiver_observes_the_leg_alone() {
    let game = game(1);
    let agents = &game.description().agents;
    let names = |agent: usize| -> Vec<&str> {
        agents[agent].observation.iter().map(|feature| feature.name.as_str()).collect()
    };
    assert_eq!((names(0), names(1)), (vec!["target", "leg"], vec!["leg"]));
    for agent in agents {
        let state = |index: &usize| &game.description().state[*index];
        assert!(agent.seen.iter().map(state).eq(&agent.observation));
    }
}
