//! The pushed versions of the robots.

use sim::{Disturbances, EnvironmentBatch};

use crate::{config, random_actions, seeded, step};

const PAIRS: [[&str; 2]; 3] = [
    ["halfcheetah-2x3", "halfcheetah-pushed-2x3"],
    ["walker2d-2x3", "walker2d-pushed-2x3"],
    ["ant-4x2", "ant-pushed-4x2"],
];

fn environment(task: &str) -> Box<dyn EnvironmentBatch> {
    sim::environments(&config(task, "none"), 1).unwrap()
}

/// Step of the first difference between a robot and its pushed version in 300 steps, if any.
fn first_difference([robot, pushed]: [&str; 2], disturbances: Disturbances) -> Option<usize> {
    let [mut robot, mut pushed] = [robot, pushed].map(environment);
    pushed.set_disturbances(disturbances);
    for world in [&mut robot, &mut pushed] {
        world.reset(0, 0, 1000, [8; 32]).unwrap();
    }
    let mut actions: Vec<f32> = vec![0.0; robot.robot().unwrap().actuators().count()];
    let mut rng = seeded(3);
    (0..300).find(|_| {
        random_actions(&mut rng, &mut actions);
        let ends = [&mut robot, &mut pushed].map(|world| step(&mut **world, &actions));
        let size = robot.description().state.len();
        ends[0] != ends[1]
            || robot.state_of(0) != pushed.state_of(0)[..size]
            || robot.observations_of(0) != pushed.observations_of(0)
    })
}

#[test]
fn a_pushed_robot_is_the_robot_until_it_is_pushed() {
    for pair in PAIRS {
        assert_eq!(first_difference(pair, Disturbances::AsInEvaluations), None, "{pair:?}");
        assert!(first_difference(pair, Disturbances::AsInTraining).is_some(), "{pair:?}");
    }
}
