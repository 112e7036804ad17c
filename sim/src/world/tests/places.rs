//! Tests of the motion of bodies as a function of coordinates and velocities.

use super::{robot, world_of};
use crate::robot::Place;

/// A free body with a hinge off the axes, a slide and a body without a joint, and a planar one.
const BODIES: &str = "<mujoco><compiler angle=\"radian\"/><worldbody>\
    <body name=\"base\" pos=\"0 0 1\"><freejoint name=\"base\"/><geom size=\"0.1\"/>\
    <body name=\"arm\" pos=\"0.2 0 0.1\" euler=\"0.3 0 0.5\">\
    <joint name=\"turn\" axis=\"1 2 0\" pos=\"0.05 0.1 0\"/><geom size=\"0.1\" pos=\"0.2 0 0\"/>\
    <body name=\"slider\" pos=\"0.3 0.1 0\"><joint name=\"slide\" type=\"slide\" axis=\"0 -1 1\"/>\
    <geom size=\"0.1\"/><body name=\"tip\" pos=\"0.1 0 0.2\" euler=\"0 0.4 0\"/></body></body></body>\
    <body name=\"walker\" pos=\"1 0 1\"><joint name=\"x\" type=\"slide\" axis=\"1 0 0\"/>\
    <joint name=\"z\" type=\"slide\" axis=\"0 0 1\"/><joint name=\"pitch\" axis=\"0 1 0\"/>\
    <geom size=\"0.1\"/><body name=\"foot\" pos=\"0 0 -0.5\"/></body></worldbody></mujoco>";

const AT: [f32; 12] = [1.0, 2.0, 3.0, 0.8, 0.0, 0.36, 0.48, 0.7, -0.2, 0.3, -0.1, 0.6];
/// MuJoCo has the angular velocity of `base` in its axes, (1, -2, 0.5).
const SPEEDS: [f32; 11] = [0.1, -0.2, 0.3, 2.104, -0.1376, -0.8968, 1.5, 0.4, 0.5, -0.6, 2.0];

/// Position, quaternion w x y z, velocity and angular velocity in the world of MuJoCo 4.0.0: `xpos`, `xquat` and
/// `mj_objectVelocity` of these bodies after `mj_forward` at the same coordinates and velocities.
const MUJOCO: [(&str, [f64; 13]); 3] = [
    (
        "arm",
        [
            1.1136, 2.18816, 2.95888, 0.47015, 0.124702, 0.65715, 0.575814, 0.2744, -0.21536,
            0.71152, 1.244076, 0.745793, -0.042314,
        ],
    ),
    (
        "tip",
        [
            0.856336, 2.581578, 2.986334, 0.330223, 0.00782, 0.737455, 0.589111, 0.6337, -0.144228,
            1.175365, 1.244076, 0.745793, -0.042314,
        ],
    ),
    (
        "foot",
        [
            1.017679, 0.0, 0.487332, 0.955336, 0.0, 0.29552, 0.0, -0.325336, 0.0, -0.035358, 0.0,
            2.0, 0.0,
        ],
    ),
];

/// A ball joint on a hinge.
const WRIST: &str = "<mujoco><compiler angle=\"radian\"/><worldbody><body name=\"arm\" pos=\"0 0 1\">\
    <joint name=\"turn\" axis=\"0 1 0\"/><geom size=\"0.1\"/><body name=\"hand\" pos=\"0.3 0 0\" euler=\"0.3 0 0.5\">\
    <joint name=\"wrist\" type=\"ball\" pos=\"0.05 0.1 0\"/><geom size=\"0.1\" pos=\"0.1 0 0\"/></body></body>\
    </worldbody></mujoco>";
const WRIST_AT: [f32; 5] = [0.3, 0.8, 0.0, 0.36, 0.48];
const WRIST_SPEEDS: [f32; 4] = [0.5, 1.0, -2.0, 0.5];
const HAND: (&str, [f64; 13]) = (
    "hand",
    [
        0.381339, 0.059805, 0.895092, 0.618144, 0.115664, 0.342029, 0.698237, -0.160177, -0.019765,
        -0.367106, 1.65135, 1.613319, -1.132945,
    ],
);

#[test]
fn bodies_move_as_in_mujoco_at_the_same_coordinates_and_velocities() {
    let bodies = MUJOCO.map(|expected| (BODIES, &AT[..], &SPEEDS[..], expected));
    let hand = (WRIST, &WRIST_AT[..], &WRIST_SPEEDS[..], HAND);
    for (model, at, speeds, (name, expected)) in bodies.into_iter().chain([hand]) {
        let robot = robot(model).unwrap();
        let body = robot.bodies().iter().position(|body| body == name).unwrap();
        let found = robot.place(body).motion(at, speeds);
        let turn = found.rotation;
        let found = [
            &found.position.to_array()[..],
            &[turn.w, turn.x, turn.y, turn.z],
            &found.velocity.to_array(),
            &found.spin.to_array(),
        ]
        .concat();
        let is_close = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-5;
        assert!(found.iter().zip(&expected).all(is_close), "{name}: {found:?}");
    }
}

#[test]
fn links_are_where_the_engine_has_them() {
    let mut world = world_of(BODIES);
    world.rebuild(&AT, &SPEEDS);
    for pose in world.link_poses() {
        let Some(body) = world.robot().bodies().iter().position(|body| *body == pose.name) else {
            continue;
        };
        let found = world.robot().place(body).motion(&AT, &SPEEDS).position;
        for (a, b) in found.to_array().iter().zip(pose.position) {
            assert!((a - f64::from(b)).abs() < 1e-5, "{}: {found}", pose.name);
        }
    }
    let fixed = Place::point([1.0, 2.0, 3.0]).motion(&AT, &SPEEDS);
    assert_eq!((fixed.position.to_array(), fixed.velocity.length()), ([1.0, 2.0, 3.0], 0.0));
}
