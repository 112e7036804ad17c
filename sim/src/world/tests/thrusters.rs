//! Actuators on sites, with the numbers that MuJoCo 4.0.0 has for them.

use super::{
    assert_continues_bit_for_bit, assert_near, motion, robot, robot_with, unsigned, world_of,
};
use crate::robot::Physics;

/// A body with four thrusters, one of which exerts a torque alone.
const CRAFT: &str = "<body pos=\"0 0 2\"><freejoint name=\"root\"/>\
    <geom type=\"box\" size=\".1 .12 .03\" pos=\".02 0 .01\" mass=\".8\"/>\
    <site name=\"a\" pos=\".14 -.14 .02\" euler=\"0 .2 .1\"/><site name=\"b\" pos=\"-.14 -.14 .02\"/>\
    <frame pos=\"0 .02 0\" euler=\"0 0 .3\"><site name=\"c\" pos=\"-.14 .14 .02\" zaxis=\".1 0 1\"/></frame>\
    <site name=\"d\" pos=\".14 .14 .02\"/></body>";
const THRUSTERS: &str = "<motor site=\"a\" gear=\"0 0 1 0 0 -.02\" ctrlrange=\"0 4\"/>\
    <motor site=\"b\" gear=\"0 0 1 0 0 .02\" ctrlrange=\"0 4\"/>\
    <motor site=\"c\" gear=\"0 .5 2 .1 0 -.02\" ctrlrange=\"0 4\"/>\
    <general name=\"yaw\" site=\"d\" gear=\"0 0 0 .02 0 -.1\" ctrlrange=\"-1 1\"/>";
/// An arm with a site in a body that is welded to its last link, and a servo.
const ARM: &str = "<body pos=\"0 0 1\"><joint name=\"hip\" axis=\"0 1 0\" damping=\".05\"/>\
    <geom type=\"capsule\" size=\".02\" fromto=\"0 0 0 .5 0 0\" mass=\".4\"/>\
    <body pos=\".5 0 0\"><joint name=\"knee\" axis=\"0 0 1\" armature=\".01\"/><geom size=\".05\" pos=\"0 .1 0\" mass=\".3\"/>\
    <body pos=\"0 .2 0\" euler=\".4 0 0\"><geom size=\".02\" mass=\".05\"/>\
    <site name=\"tip\" pos=\".01 .02 .03\" euler=\".3 .2 .1\"/></body></body></body>";
const JET: &str = "<general site=\"tip\" gear=\"1 2 3 .1 .2 .3\" ctrlrange=\"-1 1\" gainprm=\"2\" biastype=\"affine\" \
    biasprm=\".3 0 0\" forcerange=\"-.8 1.1\" dyntype=\"filter\" dynprm=\".05\"/>\
    <position joint=\"knee\" kp=\"2\" kv=\".1\" ctrlrange=\"-1 1\"/>";

/// A document without a floor, with a step of two milliseconds.
pub(super) fn flying(option: &str, bodies: &str, actuators: &str) -> String {
    format!(
        "<mujoco><compiler angle=\"radian\"/><option timestep=\".002\" {option}/><worldbody>{bodies}</worldbody>\
         <actuator>{actuators}</actuator></mujoco>"
    )
}

pub(super) fn coordinates_after(steps: usize, mjcf: &str, controls: &[f32]) -> Vec<f32> {
    let mut world = world_of(mjcf);
    for _ in 0..steps {
        assert!(world.step(controls));
    }
    motion(&world).0
}

fn refusal(bodies: &str, actuator: &str) -> String {
    robot(&flying("", bodies, actuator)).err().unwrap_or_else(|| panic!("{actuator} is accepted"))
}

#[test]
fn thrusters_move_a_free_body_as_in_mujoco() {
    for (option, expected) in [
        ("", [0.140644, 0.009848, 1.744308, -0.675227, 0.066166, -0.71166, -0.182296]),
        (
            "density=\"1.2\" viscosity=\".01\"",
            [0.138994, 0.00886, 1.744262, -0.700145, 0.063948, -0.683799, -0.195262],
        ),
        (
            "integrator=\"implicitfast\"",
            [0.142958, 0.006938, 1.74219, -0.685294, 0.083033, -0.700272, -0.181922],
        ),
        (
            "integrator=\"RK4\"",
            [0.140399, 0.007938, 1.744947, -0.695715, 0.074601, -0.688704, -0.190007],
        ),
    ] {
        let mjcf = flying(option, CRAFT, THRUSTERS);
        let found = coordinates_after(150, &mjcf, &[2.4, 1.8, 1.1, 0.6]);
        assert_near(option, &unsigned(&found), &unsigned(&expected), 1e-3);
    }
}

#[test]
fn a_thruster_on_an_arm_has_its_law_and_moves_all_joints_before_it() {
    for (option, expected) in [
        ("", [0.431808, 0.675349]),
        ("integrator=\"implicitfast\"", [0.431382, 0.677745]),
        ("integrator=\"RK4\"", [0.426735, 0.677645]),
    ] {
        let found = coordinates_after(150, &flying(option, ARM, JET), &[0.9, 0.5]);
        assert_near(option, &found, &expected, 3e-3);
    }
}

#[test]
fn the_torque_range_of_a_joint_limits_the_sum_of_thrusters_servos_and_gravity_compensation() {
    let limited = ARM
        .replace("damping=\".05\"", "damping=\".05\" actuatorfrcrange=\"-.6 .5\"")
        .replace("armature=\".01\"", "armature=\".01\" actuatorfrcrange=\"-.2 .3\"");
    let compensated = limited
        .replace("armature=\".01\"", "armature=\".01\" actuatorgravcomp=\"true\"")
        .replace("pos=\".5 0 0\"", "pos=\".5 0 0\" gravcomp=\"1\"")
        .replace("euler=\".4 0 0\"", "euler=\".4 0 0\" gravcomp=\"1\"");
    for (option, arm, expected, efforts) in [
        ("", &limited, [0.780915, 0.446081], [-0.6, 0.17182]),
        ("integrator=\"implicitfast\"", &limited, [0.780962, 0.447156], [-0.6, 0.16774]),
        ("integrator=\"RK4\"", &limited, [0.77628, 0.444715], [-0.6, 0.18008]),
        ("", &compensated, [0.153005, 0.656786], [-0.6, -0.2]),
        ("integrator=\"implicitfast\"", &compensated, [0.153002, 0.656794], [-0.6, -0.2]),
        ("integrator=\"RK4\"", &compensated, [0.15187, 0.65477], [-0.6, -0.2]),
    ] {
        let mut world = world_of(&flying(option, arm, JET));
        for _ in 0..150 {
            assert!(world.step(&[0.9, 0.5]));
        }
        assert_near(option, &motion(&world).0, &expected, 3e-3);
        assert_near(option, &world.efforts().collect::<Vec<_>>(), &efforts, 5e-3);
    }
}

#[test]
fn thrusters_continue_bit_for_bit_from_a_restored_motion() {
    let world = || world_of(&flying("", CRAFT, THRUSTERS));
    let at = [0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0];
    let speeds = [0.1, 0.0, 0.0, 0.0, 0.3, 0.0];
    assert_continues_bit_for_bit([world(), world()], &at, &speeds, &[1.9, 2.0, 1.0, 0.1]);
}

#[test]
fn an_actuator_on_a_site_names_it_with_its_link_and_unit() {
    let robot = robot(&flying("", CRAFT, THRUSTERS)).unwrap();
    let found: Vec<_> =
        robot.actuators().map(|own| (own.name, own.joint, own.pushed, own.unit)).collect();
    assert_eq!(found[0], ("a", "a", Some("body 1"), "N"));
    assert_eq!(found[3], ("yaw", "d", Some("body 1"), "N m"));
}

#[test]
fn each_craft_of_several_is_a_robot_with_thrusters() {
    let other = CRAFT.replace("name=\"", "name=\"second_").replace("0 0 2", "1 0 2");
    let block = "<body pos=\"-1 0 2\"><freejoint/><geom size=\".1\"/></body>";
    let actuators = format!(
        "{THRUSTERS}{}",
        THRUSTERS.replace("site=\"", "site=\"second_").replace("yaw", "turn")
    );
    let robot = robot(&flying("", &format!("{block}{CRAFT}{other}"), &actuators)).unwrap();
    assert_eq!(robot.driven_trees().into_iter().collect::<Vec<_>>(), [1, 2]);
    assert_eq!(robot.trees_of([5]).into_iter().collect::<Vec<_>>(), [2]);
    assert_eq!(robot.blueprint.root(), 1);
}

#[test]
fn an_actuator_on_a_site_that_cannot_be_built_is_refused() {
    let fixed = format!("{CRAFT}<body><geom size=\".1\"/><site name=\"mast\"/></body>");
    for (actuator, reason) in [
        ("<motor site=\"mast\" ctrlrange=\"0 1\"/>", "its site is fixed to the world"),
        ("<motor site=\"e\" ctrlrange=\"0 1\"/>", "`e`"),
        ("<motor site=\"a\"/>", "set `ctrlrange`"),
        ("<position site=\"a\" kp=\"2\" ctrlrange=\"0 1\"/>", "a servo needs a joint or tendon"),
        ("<motor site=\"a\" refsite=\"b\" ctrlrange=\"0 1\"/>", "not on a refsite"),
        ("<motor site=\"a\" joint=\"root\" ctrlrange=\"0 1\"/>", "remove one"),
    ] {
        let found = refusal(&fixed, actuator);
        assert!(found.contains(reason), "{actuator}: {found}");
    }
    let physics = Physics { contact_compliance: Some(0.1), ..Physics::default() };
    let built = robot_with(&flying("", CRAFT, THRUSTERS), physics, &|path| Err(path.to_owned()));
    let reason = built.err().unwrap();
    assert!(reason.contains("needs a model without actuators on sites"), "{reason}");
}
