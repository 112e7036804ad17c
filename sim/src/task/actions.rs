//! Map from actions to controls: the controls for the actions -1 and 1 of every motor.

use super::definition::{ActionsRow, Around, refused, within};
use super::rules::Rules;
use crate::error::SimError;
use crate::robot::{MotorPlan, Robot};

/// Controls for the actions -1 and 1, in the order of the model's actuators.
pub(super) fn control_ranges(
    row: &ActionsRow,
    rules: &Rules,
    robot: &Robot,
) -> Result<Vec<[f32; 2]>, SimError> {
    let motors = &robot.blueprint.motors;
    if let Some(scale) = row.scale {
        within("actions.scale", scale, 1e-6, 1e6)?;
    }
    if row.around == Around::Range {
        if row.scale.is_some() {
            return Err(refused("actions.scale needs around = \"start\""));
        }
        return Ok(motors.iter().map(|motor| motor.range).collect());
    }
    if row.scale.is_some() && motors.iter().all(|motor| held_control(motor, 0.0).is_none()) {
        return Err(refused("actions.scale is for servos of the position, and the model has none"));
    }
    let pose = rules.start_pose(robot).0;
    let range = |(index, motor): (usize, &MotorPlan)| {
        let [low, high] = motor.range;
        let at = |hinge| robot.layout.hinge_position(hinge, &pose);
        let held = held_control(motor, motor.moved.sum(at));
        let stated = rules.start.controls.get(index).copied();
        let middle = stated.or(held).unwrap_or(low / 2.0 + high / 2.0).clamp(low, high);
        let half = row.scale.filter(|_| held.is_some()).unwrap_or(high / 2.0 - low / 2.0);
        [middle - half, middle + half]
    };
    Ok(motors.iter().enumerate().map(range).collect())
}

/// Control with which a servo of the position rests at a position; `None` for other motors.
fn held_control(motor: &MotorPlan, position: f32) -> Option<f32> {
    let servo = motor.servo.filter(|_| !motor.integrates())?;
    let [constant, stiffness, _] = servo.bias;
    (stiffness != 0.0 && servo.gain != 0.0)
        .then(|| -(constant + stiffness * motor.gear * position) / servo.gain)
}
