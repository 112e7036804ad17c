//! The simulator's part of the numeric fingerprint. Programs with equal probes produce equal simulations.

use std::sync::Arc;

use crate::robot::{ANT, HALFCHEETAH, Robot, RobotRow, WALKER2D};
use crate::world::World;

const ROBOTS: &[&RobotRow] = &[&HALFCHEETAH, &WALKER2D, &ANT];
const STEPS: usize = 100;

/// All coordinates and velocities over 100 environment steps of each robot, dropped from its rest pose, under fixed
/// controls. Little-endian f32.
pub fn probe() -> Vec<u8> {
    ROBOTS.iter().flat_map(|row| trace(row)).collect()
}

fn trace(row: &'static RobotRow) -> Vec<u8> {
    let robot = Arc::new(Robot::build(row).expect("the built-in robots are valid"));
    let mut numbers = robot.rest().to_vec();
    let coordinates = numbers.len();
    numbers.extend(robot.velocity_names().iter().map(|_| 0.0));
    let mut controls = vec![0.0; robot.actuators().count()];
    let mut world = World::new(robot);
    let mut bytes = Vec::with_capacity(4 * STEPS * numbers.len());
    for step in 0..STEPS {
        for (motor, control) in controls.iter_mut().enumerate() {
            // A triangle wave in sixteenths is exact in f32 and needs no library function.
            let phase = ((3 * step + 5 * motor) % 32) as f32 / 16.0;
            *control = 1.0 - 2.0 * (phase - 1.0).abs();
        }
        world.step(&controls);
        world.coordinates(&mut numbers[..coordinates]);
        world.velocities(&mut numbers[coordinates..]);
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    }
    bytes
}
