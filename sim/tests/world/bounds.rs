//! Bounds of a HalfCheetah's motion under random and extreme controls.

use crate::{coordinates, environments, key, seeded, uniform, velocities};
use rand_chacha::ChaCha8Rng;
use sim::{EnvironmentBatch, Outcome};

/// Largest violation of a joint limit (rad), largest depth (m) and largest velocity.
#[derive(Debug, Default)]
struct Extremes {
    beyond_limit: f32,
    depth: f32,
    fastest: f32,
}

impl Extremes {
    fn note(&mut self, world: &dyn EnvironmentBatch, environment: usize) {
        let world = world.world(environment).unwrap();
        let angles = coordinates(world);
        for ((_, range), angle) in world.robot().hinges().zip(&angles[3..]) {
            let [low, high] = range.unwrap();
            self.beyond_limit = self.beyond_limit.max(low - angle).max(angle - high);
        }
        self.depth = self.depth.max(-world.lowest_point());
        let fastest = velocities(world).iter().fold(0.0_f32, |most, v| most.max(v.abs()));
        self.fastest = self.fastest.max(fastest);
    }
}

fn play(episodes: u64, steps: u32, control: impl Fn(&mut ChaCha8Rng, u32) -> f32) -> Extremes {
    let mut world = environments("halfcheetah-2x3", 1);
    let mut extremes = Extremes::default();
    for episode in 0..episodes {
        let mut rng = seeded(100 + episode);
        world.reset(0, episode, steps, key(&mut rng)).unwrap();
        for index in 0..steps {
            let actions: [f32; 6] = std::array::from_fn(|_| control(&mut rng, index));
            let mut outcome = [Outcome::default()];
            world.step(&actions, &mut outcome).unwrap();
            assert!(!outcome[0].fault && !outcome[0].terminated && outcome[0].reward.is_finite());
            assert_eq!(outcome[0].truncated, index + 1 == steps);
            extremes.note(&*world, 0);
        }
    }
    println!("{extremes:?}");
    extremes
}

#[test]
fn random_control_stays_within_limits_and_above_the_floor() {
    let extremes = play(20, 1000, |rng, _| uniform(rng));
    // MuJoCo 4.0.0 under such actions: 0.15 rad, 0.061 m.
    assert!(extremes.beyond_limit < 0.2, "{extremes:?}");
    assert!(extremes.depth < 0.09, "{extremes:?}");
    assert!(extremes.fastest < 60.0, "{extremes:?}");
}

#[test]
fn bang_bang_control_stays_within_limits_and_above_the_floor() {
    let extremes = play(20, 1000, |rng, _| if uniform(rng) < 0.0 { -1.0 } else { 1.0 });
    // MuJoCo 4.0.0 under such actions: 0.25 rad, 0.110 m.
    assert!(extremes.beyond_limit < 0.3, "{extremes:?}");
    assert!(extremes.depth < 0.13, "{extremes:?}");
}

#[test]
fn slow_full_torque_swings_stay_within_limits_and_above_the_floor() {
    let extremes = play(10, 1000, |_, index| if (index / 9) % 2 == 0 { 1.0 } else { -1.0 });
    // MuJoCo 4.0.0 under such actions: 0.16 rad, 0.086 m.
    assert!(extremes.beyond_limit < 0.2, "{extremes:?}");
    assert!(extremes.depth < 0.11, "{extremes:?}");
}

#[test]
fn actions_outside_the_range_act_clamped_and_cost_unclamped() {
    let (mut within, mut beyond) =
        (environments("halfcheetah-2x3", 1), environments("halfcheetah-2x3", 1));
    let inside = crate::step(&mut *within, &[1.0, -1.0, 1.0, -1.0, 1.0, -1.0]);
    let outside = crate::step(&mut *beyond, &[3.0, -3.0, 3.0, -3.0, 3.0, -3.0]);
    assert_eq!(within.encode(0).unwrap(), beyond.encode(0).unwrap());
    let saved = inside.reward - outside.reward;
    assert!((saved - 0.1 * (54.0 - 6.0)).abs() < 1e-4, "{saved}");
}

#[test]
fn invalid_actions_are_rejected_with_agent_and_index_without_a_step() {
    let mut world = environments("halfcheetah-2x3", 2);
    let (mut outcome, before) = ([Outcome::default(); 2], world.encode(0).unwrap());
    let mut actions = [0.2; 12];
    actions[6 + 4] = f32::NAN;
    let error = world.step(&actions, &mut outcome).unwrap_err();
    assert_eq!(error.to_string(), "the action of agent 1 in environment 1 is NaN at index 1");
    let error = world.step(&[0.2; 11], &mut outcome).unwrap_err();
    assert_eq!(error.to_string(), "got 11 action values; 2 environments need 2 x 6");
    assert_eq!(world.encode(0).unwrap(), before);
    assert_eq!(world.position(0).step, 0);
}

#[test]
fn a_fault_restores_the_last_valid_state_and_a_reset_recovers() {
    let mut world = environments("halfcheetah-2x3", 2);
    let mut outcome = [Outcome::default(); 2];
    let mut state =
        sim::State::from_bytes(&world.encode(0).unwrap(), world.state_bounds().unwrap()).unwrap();
    // At the bounds of a state: the next step leaves them.
    state.velocities[0] = world.state_bounds().unwrap().fastest;
    state.coordinates[0] = world.state_bounds().unwrap().coordinates[0][1];
    world.restore(0, &state.to_bytes(&world.state_bounds().unwrap().kind)).unwrap();
    let good = crate::coordinates(world.world(0).unwrap());
    world.step(&[0.2; 12], &mut outcome).unwrap();
    let fault = Outcome { fault: true, truncated: true, ..Outcome::default() };
    assert_eq!(outcome[0], fault);
    assert!(!outcome[1].fault, "the other environment has no fault");
    assert_eq!(crate::coordinates(world.world(0).unwrap()), good);
    world.reset(0, 1, 1000, [1; 32]).unwrap();
    world.step(&[0.2; 12], &mut outcome).unwrap();
    assert!(!outcome[0].fault);
}

#[test]
fn an_unstable_world_reports_a_fault_instead_of_nan() {
    let mut world = environments("halfcheetah-2x3", 1);
    let mut state =
        sim::State::from_bytes(&world.encode(0).unwrap(), world.state_bounds().unwrap()).unwrap();
    let signs = [1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0];
    state.velocities = signs.iter().map(|sign| sign * 999.0).collect();
    world.restore(0, &state.to_bytes(&world.state_bounds().unwrap().kind)).unwrap();
    for _ in 0..50 {
        let outcome = crate::step(&mut *world, &[1.0; 6]);
        assert!(outcome.reward.is_finite());
        let bytes = world.encode(0).unwrap();
        sim::State::from_bytes(&bytes, world.state_bounds().unwrap()).unwrap();
        let mut seen = vec![0.0; 17];
        world.state(0, &mut seen);
        assert!(seen.iter().all(|x| x.is_finite()));
    }
}
