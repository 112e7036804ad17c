//! Comparison with MuJoCo's open-loop motion of the same robot under the same controls.
//!
//! Both integrators are of first order and the robot is stiff. After one step of 0.05 s, MuJoCo's trace is 0.013 rad
//! from the exact motion (explicit springs) and this one 0.010 rad in the opposite direction (implicit springs). Over
//! half a second in flight, the largest errors are 0.022 and 0.035 rad. The model is therefore compared with short
//! steps, where both converge; at the task's step the traces are compared only to this accuracy.

use std::sync::Arc;

use crate::{coordinates, velocities};
use sim::{Robot, World};

/// Coordinates and velocities after each step of a trace.
type Trace = Vec<(Vec<f64>, Vec<f64>)>;

fn reference(name: &str) -> Trace {
    let data: serde_json::Value =
        serde_json::from_str(include_str!("../data/halfcheetah-mujoco.json")).unwrap();
    let numbers = |value: &serde_json::Value| {
        value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    };
    let steps = data[name].as_array().unwrap().iter();
    steps.map(|step| (numbers(&step["qpos"]), numbers(&step["qvel"]))).collect()
}

fn largest(got: &[f32], expected: &[f64]) -> f64 {
    got.iter().zip(expected).map(|(g, e)| (f64::from(*g) - e).abs()).fold(0.0, f64::max)
}

/// Largest difference of a coordinate and of a velocity after each step, from `height` above the rest pose.
fn differences(parts: u32, height: f32, reference: &Trace) -> Vec<(f64, f64)> {
    let mut world = World::refined(Arc::new(Robot::of_task("halfcheetah-2x3").unwrap()), parts);
    let mut start = [0.0; 9];
    start[1] = height;
    world.rebuild(&start, &[0.0; 9]);
    let steps = reference.iter().enumerate();
    steps
        .map(|(t, (expected, speeds))| {
            let control = |k| (0.5 * libm::sin(0.3 * t as f64 + f64::from(k))) as f32;
            world.step(&[0, 1, 2, 3, 4, 5].map(control));
            let mut at = coordinates(&world);
            at[1] -= height;
            (largest(&at, expected), largest(&velocities(&world), speeds))
        })
        .collect()
}

fn worst(differences: &[(f64, f64)]) -> (f64, f64) {
    println!("{differences:.5?}");
    differences.iter().fold((0.0, 0.0), |most, d| (d.0.max(most.0), d.1.max(most.1)))
}

#[test]
fn in_flight_with_short_steps_the_cheetah_moves_as_in_mujoco() {
    let (position, velocity) = worst(&differences(64, 8.0, &reference("flight")));
    assert!(position < 2e-3, "{position} m or rad");
    assert!(velocity < 5e-2, "{velocity} m/s or rad/s");
}

#[test]
fn in_flight_with_the_tasks_step_the_cheetah_stays_close_to_the_exact_motion() {
    let (position, velocity) = worst(&differences(1, 8.0, &reference("flight")));
    assert!(position < 0.04, "{position} m or rad");
    assert!(velocity < 0.8, "{velocity} m/s or rad/s");
}

#[test]
fn over_half_a_second_with_contacts_the_cheetah_stays_close_to_mujocos_trace() {
    let (position, _) = worst(&differences(1, 0.0, &reference("steps"))[..10]);
    assert!(position < 0.1, "{position} m or rad");
}
