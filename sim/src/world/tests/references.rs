//! Actuators and motions that MuJoCo computes for the same models; `tests/reference/mujoco_models.py` records them.

use serde_json::Value;

use super::{assert_continues_bit_for_bit, motion, reference, robot, world_of};

fn numbers(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap() as f32).collect()
}

#[test]
fn actuators_have_mujocos_gains_and_ranges() {
    let reference = reference();
    let mut compared = 0;
    for (model, expected) in reference["models"].as_object().unwrap() {
        let robot = robot(expected["mjcf"].as_str().unwrap()).unwrap();
        for expected in expected["motors"].as_array().unwrap() {
            let name = expected["name"].as_str().unwrap();
            let motors = &robot.blueprint().motors;
            let motor = motors.iter().find(|motor| motor.name == name).unwrap();
            assert_eq!(motor.joint, expected["joint"].as_str().unwrap(), "{model} {name}");
            let servo = motor.servo.unwrap();
            let found = [&[motor.gear, servo.gain], &servo.bias[..], &motor.range[..]].concat();
            let [gear, gain] = ["gear", "gain"].map(|key| expected[key].as_f64().unwrap() as f32);
            let [bias, range] = ["bias", "range"].map(|key| numbers(&expected[key]));
            for (got, want) in found.iter().zip([vec![gear, gain], bias, range].concat()) {
                assert!((got - want).abs() <= 2e-5 * want.abs(), "{model} {name}: {found:?}");
            }
            compared += 1;
        }
    }
    assert_eq!(compared, 4);
}

/// Both integrate with steps of a millisecond, by different rules.
#[test]
fn motions_follow_mujocos() {
    for (name, expected) in reference()["motions"].as_object().unwrap() {
        let mut world = world_of(expected["mjcf"].as_str().unwrap());
        let mut speeds = numbers(&expected["velocities"]);
        speeds.resize(world.robot().velocity_names().len(), 0.0);
        let rest = world.robot().rest().to_vec();
        world.rebuild(&rest, &speeds);
        let controls = numbers(&expected["controls"]);
        for _ in 0..expected["steps"].as_u64().unwrap() {
            assert!(world.step(&controls));
        }
        let (mut at, reached) = (motion(&world).0, numbers(&expected["qpos"]));
        at.iter_mut().zip(world.robot().reference()).for_each(|(at, by)| *at += by);
        let off = at.iter().zip(&reached).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let is_exact = name == "activations in a step of Runge and Kutta";
        let most = if is_exact { 1e-5 } else { 0.002 };
        assert!(off < most, "{name}: {at:?} against {reached:?}");
    }
}

#[test]
fn couplings_continue_from_a_restored_motion_bit_for_bit() {
    let reference = reference();
    for name in [
        "four bars",
        "a polynomial of a joint",
        "a tendon with a spring and a limit",
        "a limit of a ball joint",
        "welds",
    ] {
        let mjcf = reference["motions"][name]["mjcf"].as_str().unwrap();
        let world = || world_of(mjcf);
        let count = world().robot().coordinate_names().len();
        let mut at: Vec<f32> = (0..count).map(|index| 0.01 * (index as f32 + 1.0)).collect();
        for ball in &world().robot().layout().balls {
            at[ball.coordinate..][..4].copy_from_slice(&[-0.5, 0.1, 0.7, -0.5]);
        }
        let count = world().robot().velocity_names().len();
        let speeds: Vec<f32> = (0..count).map(|index| 2.6 - 0.4 * index as f32).collect();
        let controls = vec![0.2; world().robot().blueprint().motors.len()];
        assert_continues_bit_for_bit([world(), world()], &at, &speeds, &controls);
    }
}

#[test]
fn motions_in_a_fluid_and_with_runge_kutta_continue_bit_for_bit() {
    let reference = reference();
    for name in ["a body in a fluid", "a step of Runge and Kutta"] {
        let expected = &reference["motions"][name];
        let world = || world_of(expected["mjcf"].as_str().unwrap());
        let mut speeds = numbers(&expected["velocities"]);
        speeds.resize(world().robot().velocity_names().len(), 0.0);
        let at = world().robot().rest().to_vec();
        assert_continues_bit_for_bit([world(), world()], &at, &speeds, &[0.2]);
    }
}
