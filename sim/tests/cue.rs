//! Tests of the cue game: information in closed form, states, rejected inputs.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde_json::json;
use sim::{EnvironmentBatch, Outcome, SimError, State, StateError, TaskConfig};

const PLACES: usize = 4;
const CUES: usize = 3;

fn config(norm: &str) -> TaskConfig {
    let observation = json!({
        "mode": "full_id", "norm": norm, "nearest": 1, "globals": "hidden", "contact_forces": "absent",
    });
    let task = json!({
        "task": "cue-2x1", "observation": observation,
    });
    serde_json::from_value(task).unwrap()
}

fn game(count: usize) -> Box<dyn EnvironmentBatch> {
    sim::environments(&config("none"), count).unwrap()
}

fn reset(game: &mut dyn EnvironmentBatch, environment: usize, seed: u64) {
    let key = ChaCha8Rng::seed_from_u64(seed).get_seed();
    game.reset(environment, 7, 50, key).unwrap();
}

fn observe(game: &dyn EnvironmentBatch, environment: usize, agent: usize) -> [f32; 9] {
    let mut out = [0.0; 9];
    game.observation(environment, agent, &mut out);
    out
}

fn place_of(game: &dyn EnvironmentBatch) -> usize {
    let mut out = [0.0; PLACES];
    game.state(0, &mut out);
    out.iter().position(|&x| x == 1.0).unwrap()
}

fn cue_of(game: &dyn EnvironmentBatch, environment: usize, agent: usize) -> usize {
    observe(game, environment, agent)[PLACES..][..CUES].iter().position(|&x| x == 1.0).unwrap()
}

/// A game at `place` with the cue `cue`.
fn at(place: usize, cue: usize) -> Box<dyn EnvironmentBatch> {
    let mut game = game(1);
    let mut state =
        State::from_bytes(&game.encode(0).unwrap(), game.state_bounds().unwrap()).unwrap();
    (state.coordinates[0], state.coordinates[1]) = (place as f32, cue as f32);
    let kind = game.state_bounds().unwrap().kind.clone();
    game.restore(0, &state.to_bytes(&kind)).unwrap();
    game
}

/// Mutual information `I(a; b)` of a joint distribution `[a][b]`, nats.
fn information(joint: &[[f64; CUES]; CUES]) -> f64 {
    let own = |a: usize| joint[a].iter().sum::<f64>();
    let other = |b: usize| joint.iter().map(|row| row[b]).sum::<f64>();
    let cells = (0..CUES).flat_map(|a| (0..CUES).map(move |b| (a, b)));
    let filled = cells.filter(|&(a, b)| joint[a][b] > 0.0);
    filled.map(|(a, b)| joint[a][b] * libm::log(joint[a][b] / (own(a) * other(b)))).sum()
}

/// Mean information between the actions given the place, and given place and cue, if each agent chooses the observed
/// cue with probability `1 - 2 slip` and each other choice with `slip`.
fn enumerate(slip: f64) -> (f64, f64) {
    let (mut by_place, mut by_both) = (0.0, 0.0);
    for place in 0..PLACES {
        let mut mixed = [[0.0; CUES]; CUES];
        for cue in 0..CUES {
            let game = at(place, cue);
            assert_eq!(place_of(&*game), place);
            let mut joint = [[0.0; CUES]; CUES];
            for (a, row) in joint.iter_mut().enumerate() {
                for (b, cell) in row.iter_mut().enumerate() {
                    let chance = |choice, agent| {
                        if choice == cue_of(&*game, 0, agent) { 1.0 - 2.0 * slip } else { slip }
                    };
                    *cell = chance(a, 0) * chance(b, 1);
                    mixed[a][b] += *cell / CUES as f64;
                }
            }
            by_both += information(&joint) / (PLACES * CUES) as f64;
        }
        by_place += information(&mixed) / PLACES as f64;
    }
    (by_place, by_both)
}

#[test]
fn agents_that_follow_the_cue_share_log_3_nats_given_the_place_and_0_given_place_and_cue() {
    let (by_place, by_both) = enumerate(0.0);
    assert!((by_place - libm::log(3.0)).abs() < 1e-12 && by_both.abs() < 1e-12);
}

#[test]
fn the_information_of_agents_that_slip_has_its_closed_form() {
    // Both make the same choice with probability (q q + 2 e e), q = 1 - 2 e, in three cells; the marginals are uniform.
    for slip in [0.05, 0.2, 1.0 / 3.0] {
        let follow = 1.0 - 2.0 * slip;
        let alike = (follow * follow + 2.0 * slip * slip) / 3.0;
        let unlike = (2.0 * follow * slip + slip * slip) / 3.0;
        let closed = 3.0 * alike * libm::log(9.0 * alike) + 6.0 * unlike * libm::log(9.0 * unlike);
        let (by_place, by_both) = enumerate(slip);
        assert!((by_place - closed).abs() < 1e-12 && by_both.abs() < 1e-12, "slip {slip}");
    }
}

#[test]
fn cues_are_uniform_and_independent_between_steps_and_resets() {
    let mut game = game(1);
    let mut counts = [[0_u32; CUES]; CUES];
    for seed in 0..400 {
        reset(&mut *game, 0, seed);
        for _ in 0..50 {
            let before = cue_of(&*game, 0, 0);
            game.step(&[0.0, 1.0], &mut [Outcome::default()]).unwrap();
            counts[before][cue_of(&*game, 0, 1)] += 1;
        }
    }
    // 20,000 pairs of successive cues: 2,222 per cell with a standard deviation of 44.
    assert!(counts.iter().flatten().all(|&count| (2_000..2_450).contains(&count)), "{counts:?}");
}

#[test]
fn only_two_matches_give_a_reward_and_advance_the_place() {
    for place in 0..PLACES {
        for (first, second) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 2)] {
            let mut game = at(place, 1);
            let mut outcome = [Outcome::default()];
            game.step(&[first as f32, second as f32], &mut outcome).unwrap();
            let matched = (first, second) == (1, 1);
            assert_eq!(outcome[0].reward, if matched { 1.0 } else { 0.0 });
            assert_eq!(place_of(&*game), if matched { (place + 1) % PLACES } else { place });
        }
    }
}

#[test]
fn a_restored_game_continues_bit_for_bit_and_is_truncated_at_its_limit() {
    let (mut straight, mut cut) = (game(2), game(2));
    (0..2).for_each(|e| reset(&mut *straight, e, e as u64));
    let mut outcomes = [[Outcome::default(); 2]; 2];
    for step in 0..50 {
        for environment in 0..2 {
            cut.restore(environment, &straight.encode(environment).unwrap()).unwrap();
        }
        let actions: Vec<f32> = (0..4).map(|i| ((step * 5 + i * i) % 3) as f32).collect();
        straight.step(&actions, &mut outcomes[0]).unwrap();
        cut.step(&actions, &mut outcomes[1]).unwrap();
        assert_eq!(outcomes[0], outcomes[1]);
        assert_eq!(
            (straight.encode(0).unwrap(), straight.encode(1).unwrap()),
            (cut.encode(0).unwrap(), cut.encode(1).unwrap())
        );
        assert_eq!(observe(&*straight, 1, 0), observe(&*cut, 1, 0));
        assert_eq!(outcomes[0][0].truncated, step == 49);
    }
    let position = straight.position(0);
    assert_eq!((position.episode, position.step), (7, 50));
}

#[test]
fn an_action_that_is_not_a_choice_is_rejected_without_a_step() {
    for wrong in [3.0, 7.0, 0.5, -1.0, f32::NAN, f32::INFINITY] {
        let mut game = at(2, 1);
        let error = game.step(&[1.0, wrong], &mut [Outcome::default()]).unwrap_err();
        let expected =
            format!("the action of agent 1 in environment 0 is {wrong}, not one of 3 choices");
        assert_eq!(error.to_string(), expected);
        assert_eq!((place_of(&*game), game.position(0).step), (2, 0));
    }
}

#[test]
fn invalid_states_are_rejected_without_a_change() {
    let mut game = game(1);
    reset(&mut *game, 0, 1);
    let good = game.encode(0).unwrap();
    let (bounds, state) = (
        game.state_bounds().unwrap().clone(),
        State::from_bytes(&good, game.state_bounds().unwrap()).unwrap(),
    );
    for (index, value) in [(0, 4.0), (0, 0.5), (1, 3.0), (51, -1.0), (20, 1.5), (3, f32::NAN)] {
        let mut state = state.clone();
        state.coordinates[index] = value;
        assert!(game.restore(0, &state.to_bytes(&bounds.kind)).is_err(), "{index}: {value}");
        assert_eq!(game.encode(0).unwrap(), good);
    }
    let mut half = state.clone();
    half.coordinates[20] = 1.5;
    let error = game.restore(0, &half.to_bytes(&bounds.kind)).unwrap_err();
    let expected = StateError("coordinate 20 is 1.5, not a whole number".to_owned());
    assert!(matches!(error, SimError::State(error) if error == expected));
    assert_eq!(State::from_bytes(&half.to_bytes(&bounds.kind), &bounds), Err(expected));
    let robot = state.to_bytes("rapier/halfcheetah");
    assert!(game.restore(0, &robot).is_err());
}

#[test]
fn a_scaled_observation_is_rejected_with_the_task_and_the_setting() {
    let error = sim::environments(&config("feature_z"), 1).err().unwrap().to_string();
    assert!(error.contains("cue-2x1") && error.contains("observation.norm"), "{error}");
}
