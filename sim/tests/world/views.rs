//! Walker2d and Ant: observations, rewards and terminations.

use sim::{EnvironmentBatch, Outcome, TaskConfig};

use crate::{coordinates, environments, step};

fn with(task: &str, changes: &serde_json::Value) -> Box<dyn EnvironmentBatch> {
    let mut config = serde_json::to_value(crate::config(task, "none")).unwrap();
    for (key, value) in changes.as_object().unwrap() {
        config["observation"][key] = value.clone();
    }
    let config: TaskConfig = serde_json::from_value(config).unwrap();
    sim::environments(&config, 1).unwrap()
}

fn sizes(world: &dyn EnvironmentBatch) -> Vec<usize> {
    world.description().agents.iter().map(|agent| agent.observation.len()).collect()
}

#[test]
fn full_observations_have_the_published_sizes() {
    let n = |changes, task| {
        let world = with(task, &changes);
        (world.description().state.len(), sizes(&*world)[0])
    };
    let absent = || serde_json::json!({});
    assert_eq!(n(absent(), "walker2d-2x3"), (17, 19));
    assert_eq!(n(absent(), "walker2d-3x2"), (17, 20));
    assert_eq!(n(absent(), "walker2d-6x1"), (17, 23));
    assert_eq!(n(absent(), "ant-2x4"), (27, 29));
    let zeros = || serde_json::json!({ "contact_forces": "zeros" });
    assert_eq!(n(zeros(), "ant-2x4"), (111, 113));
    assert_eq!(n(zeros(), "ant-2x4d"), (111, 113));
    assert_eq!(n(zeros(), "ant-4x2"), (111, 115));
    assert_eq!(n(zeros(), "ant-8x1"), (111, 119));
    assert_eq!(n(zeros(), "walker2d-2x3"), (17, 19));
}

#[test]
fn local_observations_have_the_published_sizes() {
    let seen = |task: &str, globals: &str, forces: &str| {
        let changes = serde_json::json!({
            "mode": "k_nearest", "nearest": 1, "globals": globals, "contact_forces": forces,
        });
        let world = with(task, &changes);
        let padded = |agent: &proto::AgentSpec| {
            agent.observation.iter().filter(|feature| feature.name != "padding").count()
        };
        let longest = sizes(&*world);
        assert!(longest.iter().all(|size| *size == longest[0]), "{task}: {longest:?}");
        world.description().agents.iter().map(padded).collect::<Vec<usize>>()
    };
    for robot in ["halfcheetah", "walker2d"] {
        assert_eq!(seen(&format!("{robot}-2x3"), "hidden", "absent"), [7, 7]);
        assert_eq!(seen(&format!("{robot}-2x3"), "shown", "absent"), [12, 12]);
    }
    assert_eq!(seen("halfcheetah-3x2", "hidden", "absent"), [6, 7, 5]);
    assert_eq!(seen("halfcheetah-3x2", "shown", "absent"), [11, 12, 10]);
    assert_eq!(seen("walker2d-6x1", "hidden", "absent"), [4, 4, 3, 4, 4, 3]);
    assert_eq!(seen("ant-2x4", "hidden", "zeros"), [52, 52]);
    assert_eq!(seen("ant-2x4", "shown", "zeros"), [63, 63]);
    assert_eq!(seen("ant-4x2", "hidden", "zeros"), [31; 4]);
    assert_eq!(seen("ant-4x2", "shown", "zeros"), [42; 4]);
    assert_eq!(seen("ant-8x1", "hidden", "zeros"), [18, 21, 18, 21, 18, 21, 18, 21]);
    assert_eq!(seen("ant-8x1", "shown", "zeros"), [29, 32, 29, 32, 29, 32, 29, 32]);
}

#[test]
fn an_ants_slices_are_the_published_ones() {
    let joints = |task: &str| -> Vec<String> {
        let config = crate::config(task, "none");
        let world = sim::environments(&config, 1).unwrap();
        world.description().agents.iter().map(|agent| agent.joints.join(" ")).collect()
    };
    let halves = ["hip_4 ankle_4 hip_1 ankle_1", "hip_2 ankle_2 hip_3 ankle_3"];
    assert_eq!(joints("ant-2x4"), halves);
    assert_eq!(joints("ant-2x4d"), ["hip_1 ankle_1 hip_3 ankle_3", "hip_2 ankle_2 hip_4 ankle_4"]);
    assert_eq!(
        joints("ant-4x2"),
        ["hip_4 ankle_4", "hip_1 ankle_1", "hip_2 ankle_2", "hip_3 ankle_3"]
    );
    assert_eq!(joints("walker2d-2x3"), ["thigh leg foot", "thigh_left leg_left foot_left"]);
    assert_eq!(joints("walker2d-3x2"), ["thigh leg", "foot thigh_left", "leg_left foot_left"]);
}

#[test]
fn walkers_and_ants_terminate_when_they_fall_and_are_rewarded_for_standing() {
    for (task, pay) in [("walker2d-2x3", 1.0), ("ant-2x4", 1.0)] {
        let mut world = environments(task, 1);
        let size = world.description().agents.iter().map(|agent| agent.action.size).sum::<usize>();
        let before = coordinates(world.world(0).unwrap())[0];
        let mut outcome = [Outcome::default()];
        world.step(&vec![0.0; size], &mut outcome).unwrap();
        let dt = world.description().dt_secs as f32;
        let speed = (coordinates(world.world(0).unwrap())[0] - before) / dt;
        assert!((outcome[0].reward - (speed + pay)).abs() < 1e-4, "{task}: {outcome:?}");
        assert!(!outcome[0].terminated);
    }
    assert!(lifted("walker2d-2x3", 1, -0.5).terminated, "0.75 m is below 0.8 m");
    assert!(!lifted("walker2d-2x3", 1, 0.5).terminated);
    assert!(lifted("walker2d-2x3", 1, 0.8).terminated, "2.05 m is above 2 m");
    assert!(lifted("walker2d-2x3", 2, 1.1).terminated, "a lean of 1.1 rad");
    assert!(!lifted("ant-2x4", 2, 0.2).terminated);
    assert!(lifted("ant-2x4", 2, 0.4).terminated, "1.15 m is above 1 m");
}

/// One step from a start with coordinate `index` changed by `by`.
fn lifted(task: &str, index: usize, by: f32) -> Outcome {
    let mut world = environments(task, 1);
    let size = world.description().agents.iter().map(|agent| agent.action.size).sum::<usize>();
    let bounds = world.state_bounds().unwrap().clone();
    let mut state = sim::State::from_bytes(&world.encode(0).unwrap(), &bounds).unwrap();
    state.coordinates[index] += by;
    world.restore(0, &state.to_bytes(&bounds.kind)).unwrap();
    let mut outcome = [Outcome::default()];
    world.step(&vec![0.0; size], &mut outcome).unwrap();
    outcome[0]
}

#[test]
fn an_ants_start_has_a_unit_quaternion_and_angular_velocity_in_its_own_axes() {
    let mut world = with("ant-2x4", &serde_json::json!({}));
    world.reset(0, 0, 1000, [5; 32]).unwrap();
    let state =
        sim::State::from_bytes(&world.encode(0).unwrap(), world.state_bounds().unwrap()).unwrap();
    let length: f32 = state.coordinates[3..7].iter().map(|q| q * q).sum();
    assert!((length - 1.0).abs() < 1e-5);
    // A quarter turn about z: the world's x is the torso's -y.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let mut turned = state.clone();
    turned.coordinates[3..7].copy_from_slice(&[half, 0.0, 0.0, half]);
    turned.velocities[3..6].copy_from_slice(&[2.0, 0.0, 5.0]);
    world.restore(0, &turned.to_bytes(&world.state_bounds().unwrap().kind.clone())).unwrap();
    let mut seen = vec![0.0; 27];
    world.state(0, &mut seen);
    let turning = &seen[13 + 3..13 + 6];
    for (got, expected) in turning.iter().zip([0.0, -2.0, 5.0]) {
        assert!((got - expected).abs() < 1e-5, "{turning:?}");
    }
}

#[test]
fn an_action_beyond_one_acts_on_the_world_as_one_also_around_the_start() {
    let reached = |action: f32| {
        let mut world = with("quadruped-4x3", &serde_json::json!({}));
        world.reset(0, 0, 500, [5; 32]).unwrap();
        step(&mut *world, &[action; 12]);
        coordinates(world.world(0).unwrap())
    };
    assert_eq!(reached(3.0), reached(1.0));
    assert_ne!(reached(0.9), reached(1.0));
}

#[test]
fn a_quadruped_holds_its_stand_and_observes_its_velocities_in_its_own_axes() {
    let mut world = with("quadruped-4x3", &serde_json::json!({}));
    world.reset(0, 0, 500, [5; 32]).unwrap();
    (0..100).for_each(|_| assert!(!step(&mut *world, &[0.0; 12]).terminated));
    let height = coordinates(world.world(0).unwrap())[2];
    assert!((0.29..0.33).contains(&height), "{height} m; in MuJoCo 0.312 m");
    // A quarter turn about z: the world's x is the trunk's -y.
    let bounds = world.state_bounds().unwrap().clone();
    let mut state = sim::State::from_bytes(&world.encode(0).unwrap(), &bounds).unwrap();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    state.coordinates[3..7].copy_from_slice(&[half, 0.0, 0.0, half]);
    state.velocities[..6].copy_from_slice(&[1.0, 0.0, 3.0, 2.0, 0.0, 5.0]);
    world.restore(0, &state.to_bytes(&bounds.kind)).unwrap();
    let mut seen = vec![0.0; world.description().state.len()];
    world.state(0, &mut seen);
    // The positions are z, the quaternion and twelve joints.
    let velocities = &seen[17..][..6];
    for (got, expected) in velocities.iter().zip([0.0, -1.0, 3.0, 0.0, -2.0, 5.0]) {
        assert!((got - expected).abs() < 1e-5, "{velocities:?}");
    }
}
