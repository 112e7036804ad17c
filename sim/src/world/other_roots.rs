//! Tests of features that the HalfCheetah does not use: a free root, skew and reversed hinge axes, merged bodies,
//! motors on hinges without a spring, and unsupported models.

use std::borrow::Cow;
use std::sync::Arc;

use super::World;
use crate::error::SimError;
use crate::robot::{Neighbourhood, Robot, RobotRow, SoftnessOverride};

const AS_IN_MODEL: SoftnessOverride =
    SoftnessOverride { time_constant_secs: None, impedance: None, width: None };

/// A ball with two fixed opposite arms, a leg on a skew hinge axis and a leg on the axis -y.
const STRIDER: RobotRow = RobotRow {
    name: Cow::Borrowed("strider"),
    mjcf: Cow::Borrowed(
        r#"<mujoco>
      <compiler angle="radian"/>
      <default><geom conaffinity="0" density="500"/><motor ctrlrange="-1 1"/></default>
      <worldbody>
        <geom type="plane" size="1 1 1" conaffinity="1"/>
        <body name="ball" pos="0 0 5">
          <freejoint name="root"/>
          <geom type="sphere" size="0.2"/>
          <body name="left" pos="0 0.3 0"><geom type="capsule" size="0.05 0.1"/>
            <body name="leg" pos="0 0.1 0">
              <joint name="skew" axis="-1 1 0" range="-1 1" damping="0.1"/>
              <geom type="capsule" fromto="0 0 0 0.3 0.3 0" size="0.05"/>
            </body>
          </body>
          <body name="right" pos="0 -0.3 0"><geom type="capsule" size="0.05 0.1"/></body>
          <body name="tail" pos="-0.2 0 0">
            <joint name="reversed" axis="0 -1 0" range="-0.5 1" damping="0.1" armature="0.5"/>
            <geom type="capsule" fromto="0 0 0 -0.4 0 0" size="0.05"/>
          </body>
        </body>
      </worldbody>
      <actuator><motor joint="skew" gear="2"/><motor joint="reversed" gear="3"/></actuator>
    </mujoco>"#,
    ),
    frame_skip: 5,
    neighbourhood: Neighbourhood { edges: Vec::new(), touching: Vec::new(), globals: Vec::new() },
    integration: None,
    limits: AS_IN_MODEL,
    contacts: AS_IN_MODEL,
    margin: None,
    contact_compliance: None,
};

fn strider() -> World {
    World::new(Arc::new(Robot::build(STRIDER).unwrap()))
}

fn numbers(world: &World) -> (Vec<f32>, Vec<f32>) {
    let (mut at, mut motion) = (vec![0.0; 9], vec![0.0; 8]);
    world.coordinates(&mut at);
    world.velocities(&mut motion);
    (at, motion)
}

#[test]
fn bodies_without_a_joint_are_part_of_their_parents() {
    let world = strider();
    let names: Vec<&str> = world.robot().masses().map(|(name, ..)| name).collect();
    assert_eq!(names, ["ball", "leg", "tail"]);
    assert_eq!(world.robot().coordinate_names()[..4], ["root.x", "root.y", "root.z", "root.qw"]);
    assert_eq!(world.robot().coordinate_names()[7..], ["skew", "reversed"]);
    assert_eq!(world.robot().rest(), [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

#[test]
fn a_rebuilt_world_returns_its_numbers_and_continues_bit_for_bit() {
    let mut world = strider();
    let half = 0.5_f32;
    let at = [1.0, -2.0, 4.0, half, half, -half, half, 0.3, -0.2];
    let motion = [0.1, 0.2, -0.3, 1.0, 2.0, -1.0, 0.5, -0.7];
    world.rebuild(&at, &motion);
    assert_eq!(numbers(&world), (at.to_vec(), motion.to_vec()));
    for _ in 0..30 {
        world.step(&[0.5, -0.5]);
    }
    let (at, motion) = numbers(&world);
    let mut second = strider();
    world.rebuild(&at, &motion);
    second.rebuild(&at, &motion);
    for _ in 0..100 {
        assert!(world.step(&[0.2, 0.4]) && second.step(&[0.2, 0.4]));
        assert_eq!(numbers(&world), numbers(&second));
    }
}

#[test]
fn a_reversed_axis_reverses_the_rotation_and_the_motor() {
    let mut world = strider();
    let mut at = world.robot().rest().to_vec();
    at[8] = 0.4;
    world.rebuild(&at, &[0.0; 8]);
    let tail = &world.link_poses()[2];
    assert!((tail.quaternion[1] + libm::sinf(0.2)).abs() < 1e-6, "{tail:?}");
    at[8] = 0.0;
    world.rebuild(&at, &[0.0; 8]);
    world.step(&[0.0, 1.0]);
    let pushed = numbers(&world).0[8];
    world.rebuild(&at, &[0.0; 8]);
    world.step(&[0.0, -1.0]);
    let pulled = numbers(&world).0[8];
    assert!(pushed > 0.0 && pulled < 0.0, "{pushed} {pulled}");
}

#[test]
fn the_mass_centre_of_a_spinning_free_robot_follows_a_parabola() {
    let mut world = strider();
    let mut at = world.robot().rest().to_vec();
    at[2] = 40.0;
    world.rebuild(&at, &[2.0, 0.5, 1.0, 1.0, 3.0, -2.0, 0.0, 0.0]);
    let start = world.centre_of_mass();
    let (dt, h, g) = (0.01_f32, 0.002_f32, 9.81_f32);
    world.step(&[0.0; 2]);
    let first = world.centre_of_mass();
    for _ in 1..100 {
        world.step(&[0.0; 2]);
    }
    let end = world.centre_of_mass();
    let fall = |t: f32| -g * t * (t + h) / 2.0;
    let speed: [f32; 3] = std::array::from_fn(|k| (first[k] - start[k]) / dt);
    let expected =
        [start[0] + speed[0], start[1] + speed[1], start[2] + speed[2] - fall(dt) / dt + fall(1.0)];
    for axis in 0..3 {
        assert!((end[axis] - expected[axis]).abs() < 0.05, "{end:?} against {expected:?}");
    }
}

fn refusal(from: &str, to: &str) -> String {
    let mjcf = STRIDER.mjcf.replace(from, to);
    assert_ne!(mjcf, STRIDER.mjcf);
    let row = RobotRow { mjcf: mjcf.into(), ..STRIDER };
    let Some(SimError::Model { robot, reason }) = Robot::build(row).err() else {
        panic!("{to} was built");
    };
    assert_eq!(robot, "strider");
    reason
}

#[test]
fn unsupported_models_are_rejected_with_the_name_of_the_element() {
    let unknown = refusal(r#"motor joint="skew""#, r#"motor joint="lost""#);
    assert!(unknown.contains("line 22, <motor joint=\"lost\">: no hinge or slide"), "{unknown}");
}
