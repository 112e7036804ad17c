//! Tests of default classes against MuJoCo 4.0.0 (`actuator_gainprm`, `actuator_biasprm`, `actuator_dynprm`, `geom_friction`
//! and so on of the same documents).

use super::{document, robot};
use crate::robot::Robot;
use crate::scene::Shape;

const ARM: &str =
    "<body pos=\"0 0 1\"><joint name=\"j\" range=\"-1 1\"/><geom size=\"0.1\"/></body>";

fn with_defaults(defaults: &str, bodies: &str, actuators: &str) -> Result<Robot, String> {
    let defaults = format!("<mujoco><default>{defaults}</default>");
    robot(&document(bodies, actuators).replace("<mujoco>", &defaults))
}

/// Gain, bias and time constant of the only actuator, 0 without one.
fn law(defaults: &str, actuator: &str) -> [f32; 5] {
    let kind = actuator.split(' ').next().unwrap();
    let actuator = actuator.replacen(kind, &format!("{kind} joint=\"j\" ctrlrange=\"-1 1\""), 1);
    let robot = with_defaults(defaults, ARM, &format!("<{actuator}/>"));
    let robot = robot.unwrap_or_else(|error| panic!("{defaults} {actuator}: {error}"));
    let motor = &robot.blueprint.motors[0];
    let [a, b, c] = motor.servo.as_ref().map_or([0.0; 3], |servo| servo.bias);
    let time = motor.activation.as_ref().map_or(0.0, |own| own.time_constant_secs);
    [motor.servo.as_ref().map_or(1.0, |servo| servo.gain), a, b, c, time]
}

/// Defaults, an actuator, and its gain, bias and time constant in MuJoCo.
const LAWS: [(&str, &str, [f32; 5]); 23] = [
    ("<position kp='50' kv='3'/>", "general", [50.0, 0.0, -50.0, -3.0, 0.0]),
    ("<position kp='50' kv='3'/>", "velocity", [1.0, 0.0, 0.0, -1.0, 0.0]),
    ("<position kp='50' kv='3'/>", "motor", [1.0, 0.0, 0.0, 0.0, 0.0]),
    ("<position kp='50' kv='3'/>", "position kp='9'", [9.0, 0.0, -9.0, -3.0, 0.0]),
    ("<position kp='50' kv='3'/>", "general gainprm='9'", [9.0, 0.0, -50.0, -3.0, 0.0]),
    ("<position kp='5' dampratio='1'/>", "position kv='9'", [5.0, 0.0, -5.0, -9.0, 0.0]),
    ("<velocity kv='7'/>", "position", [1.0, 0.0, -1.0, 0.0, 0.0]),
    ("<velocity kv='7'/>", "general", [7.0, 0.0, 0.0, -7.0, 0.0]),
    ("<velocity kv='5'/><position kp='3'/>", "velocity", [1.0, 0.0, 0.0, -1.0, 0.0]),
    ("<velocity kv='5'/><position kp='3'/>", "position", [3.0, 0.0, -3.0, 0.0, 0.0]),
    (AFFINE, "position", [100.0, 0.0, -100.0, -10.0, 0.0]),
    (AFFINE, "velocity", [100.0, 0.0, 0.0, -100.0, 0.0]),
    (AFFINE, "general biasprm='2'", [100.0, 2.0, -100.0, -10.0, 0.0]),
    ("<position timeconst='0.2'/>", "general", [1.0, 0.0, -1.0, 0.0, 0.2]),
    ("<position timeconst='0.2'/>", "position timeconst='0'", [1.0, 0.0, -1.0, 0.0, 0.0]),
    ("<general dyntype='filterexact' dynprm='0.3'/>", "position", [1.0, 0.0, -1.0, 0.0, 0.3]),
    ("<general dyntype='filter' dynprm='0.3'/>", "velocity", [1.0, 0.0, 0.0, -1.0, 0.0]),
    ("<muscle/>", "motor", [1.0, 0.0, 0.0, 0.0, 0.0]),
    (VELOCITY_INSIDE, "position class='x'", [3.0, 0.0, -3.0, 0.0, 0.0]),
    (VELOCITY_INSIDE, "velocity class='x'", [5.0, 0.0, 0.0, -5.0, 0.0]),
    (
        "<position kp='3'/><default class='x'><general gear='1'/></default>",
        "velocity class='x'",
        [3.0, 0.0, 0.0, -3.0, 0.0],
    ),
    (
        "<position kp='3'/><default class='x'><motor/></default>",
        "general class='x'",
        [1.0, 0.0, 0.0, 0.0, 0.0],
    ),
    (
        "<general gainprm='5'/><default class='x'><position kv='3'/></default>",
        "velocity class='x'",
        [5.0, 0.0, 0.0, -5.0, 0.0],
    ),
];
const AFFINE: &str = "<general gainprm='100' biasprm='5 -100 -10' biastype='affine'/>";
const VELOCITY_INSIDE: &str = "<position kp='3'/><default class='x'><velocity kv='5'/></default>";

#[test]
fn a_default_of_another_kind_of_actuator_is_translated_as_in_mujoco() {
    for (defaults, actuator, expected) in LAWS {
        assert_eq!(law(defaults, actuator), expected, "{defaults} {actuator}");
    }
    let muscle = with_defaults("<muscle/>", ARM, "<general joint='j' ctrlrange='-1 1'/>");
    assert!(muscle.err().unwrap().contains("gaintype=\"muscle\" is not supported; set fixed"));
}

#[test]
fn the_later_of_a_control_range_and_an_inherited_one_counts() {
    let range = |defaults: &str, actuator: &str| {
        let robot = with_defaults(defaults, ARM, actuator).unwrap();
        robot.actuators().next().unwrap().control
    };
    let own = "<position joint=\"j\" inheritrange=\"1\"/>";
    assert_eq!(range("<position ctrlrange=\"-2 2\"/>", own), [-1.0, 1.0]);
    let own = "<position joint=\"j\" ctrlrange=\"-2 2\"/>";
    assert_eq!(range("<position inheritrange=\"0.5\"/>", own), [-2.0, 2.0]);
    // The law of a later kind leaves it to `general`.
    let own = "<general joint=\"j\" biastype=\"affine\" biasprm=\"0 -1\" ctrlrange=\"-2 2\"/>";
    assert_eq!(range("<position inheritrange=\"0.5\"/><motor/>", own), [-0.5, 0.5]);
    let inside = "<position inheritrange=\"0.5\"/><default class=\"x\"><intvelocity/></default>";
    assert_eq!(range(inside, &own.replace("<general", "<general class=\"x\"")), [-2.0, 2.0]);
}

#[test]
fn numbers_that_an_element_does_not_state_are_those_of_its_class() {
    let defaults = "<geom size=\"0.1 0.2 0.3\" friction=\"1 0.1 0.2\" solref=\"0.5 2\"/>\
        <joint range=\"-1 2\" solreflimit=\"0.5 2\"/>";
    let body = "<body pos=\"0 0 9\"><joint name=\"j\" range=\"\" solreflimit=\"0.3\"/>\
        <geom type=\"box\" size=\"0.5\" friction=\"0.7\" solref=\"0.03\" mass=\"1\"/></body>";
    let robot = with_defaults(defaults, body, "").unwrap();
    let link = &robot.blueprint.links[0];
    let shape = &link.shapes[0].shape;
    assert!(matches!(shape, Shape::Box { half_sizes: [0.5, 0.2, 0.3] }), "{shape:?}");
    let hinge = link.hinge().unwrap();
    assert_eq!(hinge.range, Some([-1.0, 2.0]));
    let timed = |text: &str, parts: [&str; 2]| parts.iter().all(|part| text.contains(part));
    let limit = format!("{:?}", hinge.limit.reference);
    assert!(timed(&limit, ["time_constant_secs: 0.3", "damping_ratio: 2"]), "{limit}");
    let surface = format!("{:?}", link.shapes[0].surface);
    assert!(timed(&surface, ["friction: [0.7, 0.1, 0.2]", "solref: [0.03, 2.0]"]), "{surface}");
}

#[test]
fn an_empty_attribute_counts_as_none() {
    let bodies = "<body name=\"\" pos=\"0 0 9\"><joint name=\"j\" type=\"ball\" axis=\"0 0 0\"/>\
        <geom name=\"\" size=\"0.1\"/></body><body name=\"\" pos=\"0 5 9\"><joint name=\"k\" damping=\"\"/>\
        <geom name=\"\" size=\"0.1\" friction=\"\" condim=\" \"/></body>";
    let motor = "<motor name=\"\" joint=\"k\" gear=\"\" ctrlrange=\"-1 1\"/>".repeat(2);
    let key = "<keyframe><key name=\"\" qpos=\"\" ctrl=\"\"/></keyframe></mujoco>";
    let robot = robot(&document(bodies, &motor).replace("</mujoco>", key)).unwrap();
    assert_eq!(robot.coordinate_names(), ["j.qw", "j.qx", "j.qy", "j.qz", "k"]);
    assert_eq!(robot.bodies(), ["world", "body 1", "body 2"]);
    let keyframe = &robot.blueprint.keyframes[0];
    assert!(keyframe.positions.is_empty() && keyframe.controls.is_empty());
}
