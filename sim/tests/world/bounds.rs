//! Controls outside their range, invalid actions, faults, and the weight on the floor.

use crate::{cheetah, environments};
use sim::Outcome;

#[test]
fn the_floor_supports_the_whole_weight_of_the_cheetah() {
    let mut world = cheetah();
    for _ in 0..200 {
        world.step(&[0.0; 6]);
    }
    // The robot has 14 kg: the impulse of one physics step is m g h.
    let weight = 14.0 * 9.81 * 0.01;
    let impulse = world.contact_impulse();
    println!("{impulse} N s against {weight}");
    assert!((impulse - weight).abs() < 0.05 * weight, "{impulse} N s against {weight}");
    assert!(world.lowest_point() > -0.01);
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
    for (wrong, shown) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (-1.5e6, "-1.5e6")] {
        actions[6 + 4] = wrong;
        let error = world.step(&actions, &mut outcome).unwrap_err();
        let line = format!(
            "the action of agent 1 in environment 1 is {shown} at index 1; it must be a number from -1e6 to 1e6"
        );
        assert_eq!(error.to_string(), line);
    }
    let error = world.step(&[0.2; 11], &mut outcome).unwrap_err();
    assert_eq!(error.to_string(), "got 11 action values; 2 environments need 2 x 6");
    assert_eq!(world.encode(0).unwrap(), before);
    assert_eq!(world.position(0).step, 0);
}

#[test]
fn the_largest_actions_have_finite_rewards_and_leave_a_valid_state() {
    for task in sim::task_names()
        .iter()
        .filter(|task| !["cue-2x1", "signal-2x1", "jump-4x1"].contains(task))
    {
        let mut world = environments(task, 1);
        let agents = world.description().agents.iter();
        let size = agents.map(|agent| agent.action.size).sum();
        for sign in [1.0, -1.0] {
            let outcome = crate::step(&mut *world, &vec![sign * 1e6; size]);
            assert!(outcome.reward.is_finite(), "{task}: {outcome:?}");
        }
        let state = world.encode(0).unwrap();
        world.restore(0, &state).unwrap();
    }
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
