//! Tests of worlds of models that no task ships: MJCF elements, one document of several files, other roots, refused
//! models.

mod accepted;
mod conditions;
mod contacts;
mod defaults;
mod hostile;
mod integrators;
mod invalid;
mod loaded;
mod motions;
mod one_document;
mod other_roots;
mod places;
mod public_models;
mod references;
mod refused;
mod thrusters;
mod trees;

use std::sync::Arc;

use super::World;
use crate::robot::{Neighbourhood, Physics, Robot, RobotRow};

/// Physics step of the models of [`document`], s.
const STEP: f32 = 0.001;

/// A free body whose mass centre is far from its origin, with an arm.
const LOPSIDED: &str = "<body pos=\"0 0 40\"><freejoint name=\"root\"/>\
    <geom type=\"box\" size=\"0.1 0.2 0.3\" pos=\"0.4 0.1 0\"/>\
    <body pos=\"-0.2 0 0\"><joint name=\"j\" axis=\"1 1 0\" damping=\"0.1\"/>\
    <geom type=\"capsule\" size=\"0.05\" fromto=\"0 0 0 -0.3 0.3 0\"/></body></body>";

/// A document with a floor, a step of a millisecond, and these bodies and actuators.
fn document(bodies: &str, actuators: &str) -> String {
    format!(
        "<mujoco><compiler angle=\"radian\"/><option timestep=\"{STEP}\"/><worldbody>\n\
         <geom type=\"plane\" size=\"1 1 1\"/>\n{bodies}\n</worldbody>\n\
         <actuator>{actuators}</actuator></mujoco>"
    )
}

/// A robot of a document. Its environment step is one physics step.
fn robot(mjcf: &str) -> Result<Robot, String> {
    robot_of_files(mjcf, &|path| match path {
        "parts/trough.obj" => Ok(trough().into_bytes()),
        path => Err(format!("{path} does not exist")),
    })
}

/// A robot of a document and the files that it names.
fn robot_of_files(
    mjcf: &str,
    source: &dyn Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<Robot, String> {
    robot_with(mjcf, Physics::default(), source)
}

/// A robot with what a task states of its physics.
fn robot_with(
    mjcf: &str,
    physics: Physics,
    source: &dyn Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<Robot, String> {
    let row = RobotRow {
        name: "loaded".to_owned(),
        mjcf: mjcf.to_owned(),
        frame_skip: 1,
        neighbourhood: Neighbourhood::default(),
        physics,
    };
    Robot::of_files(row, source).map_err(|error| error.to_string())
}

fn world_of(mjcf: &str) -> World {
    World::new(Arc::new(robot(mjcf).unwrap()))
}

/// Models and their properties in MuJoCo.
fn reference() -> serde_json::Value {
    serde_json::from_str(include_str!("../../tests/data/mujoco-models.json")).unwrap()
}

/// The mesh file of these models.
fn trough() -> String {
    reference()["files"]["parts/trough.obj"].as_str().unwrap().to_owned()
}

/// Coordinates and velocities.
fn motion(world: &World) -> (Vec<f32>, Vec<f32>) {
    let mut at = vec![0.0; world.robot().coordinate_names().len()];
    let mut velocities = vec![0.0; world.robot().velocity_names().len()];
    world.coordinates(&mut at);
    world.velocities(&mut velocities);
    (at, velocities)
}

fn assert_near(what: &str, got: &[f32], expected: &[f32], most: f32) {
    assert_eq!(got.len(), expected.len(), "{what}");
    let off = got.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off <= most, "{what}: {got:?} against {expected:?}");
}

/// The coordinates of a free body with a quaternion of which the largest number is positive.
fn unsigned(coordinates: &[f32]) -> Vec<f32> {
    let turn = &coordinates[3..7];
    let largest = turn.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap();
    let turn = turn.iter().map(|part| part * largest.signum());
    coordinates[..3].iter().copied().chain(turn).collect()
}

/// A rebuilt world has these numbers, and after some steps, a rebuilt second one continues as the first.
fn assert_continues_bit_for_bit(
    [mut first, mut second]: [World; 2],
    at: &[f32],
    speeds: &[f32],
    controls: &[f32],
) {
    first.rebuild(at, speeds);
    assert_eq!(motion(&first), (at.to_vec(), speeds.to_vec()));
    for _ in 0..100 {
        assert!(first.step(controls));
    }
    let (at, speeds) = motion(&first);
    second.rebuild(&at, &speeds);
    for _ in 0..100 {
        assert!(first.step(controls) && second.step(controls));
        assert_eq!(motion(&first), motion(&second));
    }
}
