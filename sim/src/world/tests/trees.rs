//! Tests of worlds with several trees of bodies: robots and objects.

use std::sync::Arc;

use super::contacts::{assert_moves_as_in_mujoco, numbers};
use super::{
    LOPSIDED, World, assert_continues_bit_for_bit, document, motion, robot, robot_with, world_of,
};
use crate::robot::Physics;
use crate::state::State;

/// A ball that lies on a hinged plate, which is the robot, and a free box without a joint's name.
const PLATE: &str = "<body name=\"ball\" pos=\"0 0 1.06\"><freejoint/><geom size=\"0.05\"/></body>\
    <body name=\"plate\" pos=\"0 0 1\"><joint name=\"tilt\" axis=\"0 1 0\"/>\
    <geom type=\"box\" size=\"0.2 0.2 0.01\"/></body>\
    <body name=\"box\" pos=\"2 0 1\"><freejoint/><geom type=\"box\" size=\"0.1 0.1 0.1\"/></body>";
const TILT: &str = "<motor joint=\"tilt\" ctrlrange=\"-1 1\"/>";

/// Models with their motion in MuJoCo.
fn reference() -> serde_json::Value {
    serde_json::from_str(include_str!("../../../tests/data/mujoco-trees.json")).unwrap()
}

#[test]
fn robots_and_objects_move_as_in_mujoco() {
    assert_moves_as_in_mujoco(&reference(), |name| match name {
        // Both engines choose among the points of two boxes.
        "ball in a box on a table" => 3e-4,
        "stack of three boxes" => 5e-4,
        _ => 1e-5,
    });
}

/// Coordinates and velocities after 60 steps in MuJoCo 4.0.0, with either order of the pairs.
#[test]
fn shapes_that_two_pairs_name_touch_twice() {
    let mjcf = "<mujoco><option gravity=\"3 0 -9.81\"/><worldbody><geom name=\"f\" type=\"plane\" size=\"1 1 1\"/>\
        <body name=\"b\" pos=\"0 0 .0999\"><freejoint/><geom name=\"a\" size=\".1\" mass=\"1\"/></body></worldbody><contact>\
        <pair geom1=\"a\" geom2=\"f\" friction=\"1 1\"/><pair geom1=\"f\" geom2=\"a\" friction=\".01 .01\"/></contact></mujoco>";
    let mut world = world_of(mjcf);
    for _ in 0..60 {
        assert!(world.step(&[]));
    }
    let (at, velocities) = motion(&world);
    for (found, expected) in [
        (at[0], 1.57878e-2),
        (at[2], 9.99982e-2),
        (velocities[0], 2.580634e-1),
        (velocities[2], 1.05098e-4),
        (velocities[4], 2.547993),
    ] {
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    }
}

#[test]
fn several_trees_continue_from_a_restored_motion_bit_for_bit() {
    for model in reference()["models"].as_object().unwrap().values() {
        let world = || world_of(model["mjcf"].as_str().unwrap());
        let (at, speeds) = (world().robot().rest().to_vec(), numbers(&model["speeds"]));
        let controls = numbers(&model["controls"]);
        assert_continues_bit_for_bit([world(), world()], &at, &speeds, &controls);
    }
}

#[test]
fn coordinates_have_the_order_of_the_bodies_and_the_root_is_that_of_the_first_driven_tree() {
    let robot = robot(&document(PLATE, TILT)).unwrap();
    let names = robot.coordinate_names();
    assert_eq!(
        (names[0].as_str(), names[7].as_str(), names[8].as_str()),
        ("ball.x", "tilt", "box.x")
    );
    assert_eq!(robot.rest()[..8], [0.0, 0.0, 1.06, 1.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(robot.blueprint.links[robot.layout.root].name, "plate");
}

#[test]
fn a_distant_object_does_not_change_a_robot() {
    let finger = |distance: f32| {
        let object =
            format!("<body pos=\"{distance} 0 1\"><freejoint/><geom size=\"0.1\"/></body>");
        let bodies = format!(
            "{object}<body pos=\"0 0 1\"><joint name=\"a\" axis=\"0 1 0\"/>\
             <geom type=\"capsule\" size=\"0.01\" fromto=\"0 0 0 0.04 0.01 0\" mass=\"0.004\"/>\
             <body pos=\"0.04 0.01 0\"><joint name=\"b\" axis=\"1 0 1\"/>\
             <geom type=\"capsule\" size=\"0.01\" fromto=\"0 0 0 0.03 0 0.01\" mass=\"0.004\"/></body></body>"
        );
        let mut world = world_of(&document(&bodies, ""));
        for _ in 0..300 {
            assert!(world.step(&[]));
        }
        motion(&world).0[7..].to_vec()
    };
    assert_eq!(finger(10_000.0), finger(1.0));
}

#[test]
fn links_of_different_trees_touch_without_self_contacts() {
    let physics = Physics { self_contacts: Some(false), ..Physics::default() };
    let robot = robot_with(&document(PLATE, TILT), physics, &|path| Err(path.to_owned())).unwrap();
    let mut world = World::new(Arc::new(robot));
    for _ in 0..100 {
        assert!(world.step(&[0.0]));
    }
    let height = motion(&world).0[2];
    assert!((height - 1.06).abs() < 0.002, "the ball is at {height}");
}

/// A ball on a vertical slide, 0.1 m above a box that is fixed to the world: in another body, or in the base of the ball.
/// Without a free joint, the fixed bodies are a link.
fn ball_over_box([after_box, at_end]: [&str; 2]) -> String {
    let bodies = format!(
        "<body name=\"step\"><geom type=\"box\" size=\"0.5 0.5 0.2\" pos=\"0 0 0.2\"/>{after_box}\
         <body name=\"ball\" pos=\"0 0 0.6\"><joint name=\"lift\" type=\"slide\" axis=\"0 0 1\"/>\
         <geom size=\"0.1\"/></body>{at_end}"
    );
    document(&bodies, "<motor joint=\"lift\" ctrlrange=\"-1 1\"/>")
}

const APART: [&str; 2] = ["</body>", ""];
const IN_BASE: [&str; 2] = ["", "</body>"];

#[test]
fn only_a_robots_own_base_is_not_touched_without_self_contacts() {
    let dropped = "links do not touch each other: contacts between 2 shapes";
    // With a free joint, fixed bodies are no links.
    let free = "<body pos=\"9 0 9\"><freejoint/><geom size=\"0.1\"/></body></worldbody>";
    // The ball stops on the box, or falls through it to the floor.
    for (place, others, expected, left_out) in [
        (APART, "</worldbody>", -0.1, ""),
        (IN_BASE, "</worldbody>", -0.5, dropped),
        (APART, free, -0.1, ""),
        (IN_BASE, free, -0.5, ""),
    ] {
        let physics = Physics { self_contacts: Some(false), ..Physics::default() };
        let mjcf = ball_over_box(place).replace("</worldbody>", others);
        let robot = robot_with(&mjcf, physics, &|path| Err(path.to_owned())).unwrap();
        assert_eq!(robot.left_out().join("; "), left_out);
        let mut world = World::new(Arc::new(robot));
        for _ in 0..1000 {
            assert!(world.step(&[0.0]));
        }
        let fallen = motion(&world).0[0];
        assert!((fallen - expected).abs() < 0.01, "{fallen} m against {expected} m");
    }
}

#[test]
fn the_engines_solver_is_refused_if_a_fixed_body_other_than_the_base_can_be_touched() {
    let built = |place| {
        let physics = Physics { contact_compliance: Some(0.1), ..Physics::default() };
        robot_with(&ball_over_box(place), physics, &|path| Err(path.to_owned())).map(drop)
    };
    let refused = built(APART).unwrap_err();
    assert!(refused.contains("a world with one plane and nothing else to touch"), "{refused}");
    assert_eq!(built(IN_BASE), Ok(()));
}

#[test]
fn the_engines_solver_has_no_part_in_contacts_of_constraints() {
    let mut world = world_of(&document(PLATE, TILT));
    assert!(world.step(&[0.0]));
    assert!(world.contact_impulse() > 0.0);
    assert_eq!(world.physics.narrow_phase.contact_pairs().count(), 0);
}

#[test]
fn a_state_with_a_second_quaternion_that_is_not_a_unit_is_refused() {
    let robot = robot(&document(PLATE, TILT)).unwrap();
    let bounds = robot.state_bounds(10);
    let position = proto::EpisodePosition { episode: 0, step: 0, limit: 10 };
    let mut state = State {
        position,
        coordinates: robot.rest().to_vec(),
        velocities: vec![0.0; robot.velocity_names().len()],
        activations: Vec::new(),
        actions: Vec::new(),
        measurements: Vec::new(),
        draws: None,
    };
    assert_eq!(State::from_bytes(&state.to_bytes(&bounds.kind), &bounds).unwrap(), state);
    state.coordinates[11] = 0.9;
    let error = State::from_bytes(&state.to_bytes(&bounds.kind), &bounds).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the orientation at coordinate 11 has squared length 0.80999994, not 1"
    );
}

#[test]
fn the_engines_solver_is_refused_for_several_trees() {
    let physics = Physics { contact_compliance: Some(0.1), ..Physics::default() };
    let mjcf = document(
        &format!("{LOPSIDED}{LOPSIDED}").replace("name=\"root\"", "").replace("name=\"j\" ", ""),
        "",
    );
    let refused = robot_with(&mjcf, physics, &|path| Err(path.to_owned())).err().unwrap();
    assert!(
        refused.contains(
            "`physics.contact_compliance` needs a model with one tree of bodies; remove it"
        ),
        "{refused}"
    );
}
