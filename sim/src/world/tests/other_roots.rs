//! Tests of features that the HalfCheetah does not use: a free root, skew and reversed hinge axes, merged bodies,
//! motors on hinges without a spring.

use super::{World, assert_continues_bit_for_bit, motion, world_of};

/// A ball with two fixed opposite arms, a leg on a skew hinge axis and a leg on the axis -y.
const STRIDER: &str = r#"<mujoco>
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
</mujoco>"#;

fn strider() -> World {
    world_of(STRIDER)
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
    let at = [1.0, -2.0, 4.0, 0.5, 0.5, -0.5, 0.5, 0.3, -0.2];
    let speeds = [0.1, 0.2, -0.3, 1.0, 2.0, -1.0, 0.5, -0.7];
    assert_continues_bit_for_bit([strider(), strider()], &at, &speeds, &[0.5, -0.5]);
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
    assert!(world.step(&[0.0, 1.0]));
    let pushed = motion(&world).0[8];
    world.rebuild(&at, &[0.0; 8]);
    assert!(world.step(&[0.0, -1.0]));
    let pulled = motion(&world).0[8];
    assert!(pushed > 0.0 && pulled < 0.0, "{pushed} {pulled}");
}
