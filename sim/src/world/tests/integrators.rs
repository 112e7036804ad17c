//! Forces that depend on speeds, by MuJoCo's integrators and flags, with the numbers that MuJoCo 4.0.0 has for them.

use super::thrusters::{coordinates_after, flying};
use super::{assert_near, robot, unsigned};

/// Two links that turn about different axes.
const ARM: &str = "<body pos=\"0 0 1\"><joint name=\"hip\" axis=\"0 1 0\" damping=\".3\"/>\
    <geom type=\"capsule\" size=\".02\" fromto=\"0 0 0 .5 0 0\" mass=\".4\"/>\
    <body pos=\".5 0 0\"><joint name=\"knee\" axis=\"0 0 1\" damping=\".05\" armature=\".002\"/>\
    <geom size=\".05\" pos=\"0 .1 0\" mass=\".3\"/></body></body>";
const IMPLICIT: &str = "integrator=\"implicitfast\"";

/// The document with this flag.
fn flagged(mjcf: &str, flag: &str) -> String {
    mjcf.replace("<worldbody>", &format!("<option><flag {flag}=\"disable\"/></option><worldbody>"))
}

#[test]
fn damping_is_explicit_with_the_integrator_euler_and_the_flag_eulerdamp_disabled() {
    let servo = "<velocity joint=\"hip\" kv=\".2\" ctrlrange=\"-1 1\"/>\
        <motor joint=\"knee\" ctrlrange=\"-1 1\"/>";
    for (option, expected) in [("", [0.071253, 0.141326]), (IMPLICIT, [0.070655, 0.139362])] {
        let mjcf = flagged(&flying(option, ARM, servo), "eulerdamp");
        assert_near(option, &coordinates_after(40, &mjcf, &[0.9, 0.3]), &expected, 1e-4);
        assert!(robot(&mjcf).unwrap().left_out().is_empty());
    }
}

#[test]
fn a_force_that_grows_with_the_speed_is_implicit_with_implicit_integrators() {
    let arm = ARM.replace("damping=\".3\"", "damping=\".1\"");
    let growing = "<general joint=\"hip\" biastype=\"affine\" biasprm=\"0 0 .2\" ctrlrange=\"-1 1\"/>\
        <motor joint=\"knee\" ctrlrange=\"-1 1\"/>";
    for (option, expected) in [
        ("", [0.688311, 0.292081]),
        (IMPLICIT, [0.690958, 0.289409]),
        ("integrator=\"RK4\"", [0.683304, 0.286811]),
    ] {
        let found = coordinates_after(100, &flying(option, &arm, growing), &[0.9, 0.3]);
        assert_near(option, &found, &expected, 3e-4);
    }
}

#[test]
fn the_damping_ratio_of_a_servo_of_a_ball_joint_is_that_of_its_axis() {
    let ball = "<body pos=\"0 0 1\"><joint name=\"b\" type=\"ball\"/>\
        <geom type=\"capsule\" fromto=\"0 0 0 .3 0 0\" size=\".03\"/></body>";
    for (gear, expected) in [
        ("0 1 0", [0.914496, 0.0, 0.404595, 0.0]),
        ("1 0 0", [0.856073, 0.2827, 0.41103, -0.135179]),
        ("0 0 2", [0.892077, -0.067078, 0.425905, 0.135291]),
    ] {
        let servo = format!(
            "<position joint=\"b\" gear=\"{gear}\" kp=\"10\" dampratio=\".5\" ctrlrange=\"-1 1\"/>"
        );
        let found = coordinates_after(100, &flying(IMPLICIT, ball, &servo), &[0.6]);
        let at = [0.0, 0.0, 0.0].map(f32::from);
        let [found, expected] = [&found[..], &expected].map(|turn| unsigned(&[&at, turn].concat()));
        assert_near(gear, &found, &expected, 3e-4);
    }
}

#[test]
fn bodies_touch_their_parents_with_the_flag_filterparent_disabled() {
    let bodies = "<body pos=\"0 0 1\"><joint name=\"hip\" axis=\"0 1 0\" damping=\".3\"/><geom size=\".1\"/>\
        <body pos=\"0 0 -.15\"><joint name=\"knee\" axis=\"0 0 1\" type=\"slide\" damping=\"1\"/>\
        <geom size=\".1\"/></body></body>";
    let motors =
        "<motor joint=\"hip\" ctrlrange=\"-1 1\"/><motor joint=\"knee\" ctrlrange=\"-1 1\"/>";
    let mjcf = flying("", bodies, motors);
    for (mjcf, expected) in
        [(flagged(&mjcf, "filterparent"), [0.004578, -0.090762]), (mjcf, [0.006156, -0.031265])]
    {
        let found = coordinates_after(40, &mjcf, &[0.3, 0.9]);
        assert_near(&mjcf, &found, &expected, 3e-4);
    }
}
