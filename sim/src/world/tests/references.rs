//! Actuators and motions that MuJoCo computes for the same models; `tests/reference/mujoco_models.py` records them.

use serde_json::Value;

use super::{assert_continues_bit_for_bit, motion, reference, robot, world_of};

/// A ball with a spring, a hinge with a `springdamper`, and a tendon that pulls it and a slide.
const SPRINGS: &str = "<mujoco><compiler angle=\"radian\"/><default><geom contype=\"0\" conaffinity=\"0\"/></default><worldbody>\
    <body pos=\"0 0 1\"><joint name=\"neck\" type=\"ball\" stiffness=\"2\" pos=\"0 0 0.1\"/>\
    <geom type=\"capsule\" size=\"0.02\" fromto=\"0 0 0 0.3 0.1 0\" mass=\"0.5\"/>\
    <body pos=\"0.3 0.1 0\"><joint name=\"tip\" axis=\"0 1 0\" springdamper=\"0.5 0.7\" armature=\"0.01\"/>\
    <geom size=\"0.03\" pos=\"0.1 0 0\" mass=\"0.2\"/></body></body>\
    <body pos=\"0 1 0\"><joint name=\"slide\" type=\"slide\" axis=\"0 0 1\" ref=\"0.1\" stiffness=\"30\"/>\
    <geom size=\"0.05\" mass=\"0.3\"/></body></worldbody>\
    <tendon><fixed name=\"t\" stiffness=\"40\" springlength=\"0 0.1\"><joint joint=\"tip\" coef=\"0.5\"/>\
    <joint joint=\"slide\" coef=\"1\"/></fixed></tendon>\
    <actuator><motor joint=\"neck\" gear=\"0 2 0\" ctrlrange=\"-1 1\"/>\
    <motor joint=\"slide\" gear=\"3\" ctrlrange=\"-1 1\"/></actuator></mujoco>";

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
            let motors = &robot.blueprint.motors;
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

/// MuJoCo 4.0.0: the sum of `energy` after `mj_energyPos` and `mj_energyVel`, with a stretched and with a compressed tendon.
#[test]
fn the_energy_is_mujocos_with_springs_of_balls_tendons_and_springdampers() {
    let mut world = world_of(SPRINGS);
    for (slide, expected) in [(0.3, 20.621_95), (-0.4, 10.311_85)] {
        world.rebuild(&[0.8, 0.4, -0.2, 0.4, 0.6, slide], &[1.0, -2.0, 0.5, 3.0, 0.7]);
        let energy = world.mechanical_energy();
        assert!((energy - expected).abs() < 2e-5, "{slide}: {energy}");
    }
}

#[test]
fn efforts_are_gear_times_control_without_springs_and_0_after_a_rebuild() {
    let mut world = world_of(SPRINGS);
    assert!(world.step(&[0.5, 0.5]));
    // Tip and slide, then the rotations of the neck. The tendon has a spring, of which nothing counts.
    assert_eq!(world.efforts().collect::<Vec<_>>(), [0.0, 1.5, 0.0, 1.0, 0.0]);
    let rest = world.robot().rest().to_vec();
    world.rebuild(&rest, &[0.0; 5]);
    assert_eq!(world.efforts().collect::<Vec<_>>(), [0.0; 5]);
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
        for ball in &world().robot().layout.balls {
            at[ball.coordinate..][..4].copy_from_slice(&[-0.5, 0.1, 0.7, -0.5]);
        }
        let count = world().robot().velocity_names().len();
        let speeds: Vec<f32> = (0..count).map(|index| 2.6 - 0.4 * index as f32).collect();
        let controls = vec![0.2; world().robot().blueprint.motors.len()];
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

/// MuJoCo 4.0.0 after 100 steps of 5 ms. Its Euler integrator is explicit, and gets elsewhere.
#[test]
fn implicit_integrators_take_the_gyroscopic_forces_of_single_free_bodies_as_mujoco_does() {
    let level = [0.05, 0.1, 0.85, 0.024091, -0.204358, 0.12408, 0.970702];
    let aside = [0.435467, 0.007821, 0.76016, 0.024091, -0.204358, 0.12408, 0.970702];
    let welded = [0.360638, -0.038849, 0.807228, -0.06159, -0.144219, 0.205343, 0.966044];
    let explicit = [0.434649, 0.010857, 0.757325, 0.007531, -0.213549, 0.105278, 0.971214];
    let [empty, ball] = ["<site/>", "<geom size=\".1\"/>"]
        .map(|inside| format!("<body pos=\"0 0 .1\">{inside}</body>"));
    let at = ".05 -.02 .1";
    for (integrator, pos, child, expected) in [
        ("implicitfast", "0 0 0", "", level),
        ("implicitfast", at, "", aside),
        ("implicit", at, "", aside),
        ("implicitfast", at, &empty, aside),
        ("implicitfast", at, &ball, welded),
        ("Euler", at, "", explicit),
    ] {
        let mut world = world_of(&format!(
            "<mujoco><option timestep=\".005\" gravity=\"0 0 0\" integrator=\"{integrator}\"/><worldbody>\
             <body pos=\"0 0 1\"><freejoint/><geom type=\"box\" size=\".1 .2 .03\" pos=\"{pos}\"/>{child}</body>\
             </worldbody></mujoco>"
        ));
        let rest = world.robot().rest().to_vec();
        world.rebuild(&rest, &[0.1, 0.2, -0.3, 3.0, 4.0, 5.0]);
        for _ in 0..100 {
            assert!(world.step(&[]));
        }
        let at = motion(&world).0;
        let off = at.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 5e-5, "{integrator} {pos} {child}: {at:?}");
    }
}

/// MuJoCo 4.0.0 after a second. The control is the speed of the target, which stays in `actrange`.
#[test]
fn an_intvelocity_actuator_follows_its_integrated_control_as_mujocos_does() {
    for (joint, class, actuator, expected) in [
        ("", "", "actrange=\"-1 1\"", 1.040807),
        ("range=\"-30 20\"", "", "inheritrange=\"0.8\" actlimited=\"true\"", 0.331372),
        ("range=\"-30 20\"", "actrange=\"-1 1\"", "inheritrange=\"0.8\"", 0.331372),
    ] {
        let mut world = world_of(&format!(
            "<mujoco><default><intvelocity {class}/></default>\
             <option timestep=\".002\" integrator=\"implicitfast\"/><worldbody><body pos=\"0 0 1\">\
             <joint name=\"j\" axis=\"0 1 0\" {joint}/><geom size=\".05\" pos=\".3 0 0\" mass=\"1\"/></body></worldbody><actuator>\
             <intvelocity joint=\"j\" kp=\"40\" kv=\"3\" {actuator} ctrlrange=\"-2 2\"/></actuator></mujoco>"
        ));
        for _ in 0..500 {
            assert!(world.step(&[1.2]));
        }
        let at = motion(&world).0[0];
        assert!((at - expected).abs() < 1e-4, "{actuator}: {at}");
    }
}

/// MuJoCo 4.0.0 after 0.1 s and 0.5 s.
#[test]
fn both_ends_of_a_range_push_where_their_margins_overlap() {
    for (margin, [first, then]) in
        [(".3", [0.048185, 0.049677]), (".5", [0.048103, 0.049677]), ("2", [0.048103, 0.049677])]
    {
        let mut world = world_of(&format!(
            "<mujoco><option timestep=\".001\"/><compiler angle=\"radian\"/><worldbody><body pos=\"0 0 1\">\
             <joint name=\"j\" axis=\"0 -1 0\" range=\"-.2 .3\" margin=\"{margin}\"/>\
             <geom size=\".05\" pos=\".3 0 0\" mass=\"1\"/></body></worldbody></mujoco>"
        ));
        let rest = world.robot().rest().to_vec();
        world.rebuild(&rest, &[1.0]);
        for (steps, expected) in [(100, first), (400, then)] {
            for _ in 0..steps {
                assert!(world.step(&[]));
            }
            let at = motion(&world).0[0];
            assert!((at - expected).abs() < 5e-5, "{margin}: {at} against {expected}");
        }
    }
}
