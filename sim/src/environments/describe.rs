//! A task's description, from its row, its robot and its partition.

use crate::description::{ActionRange, AgentDescription, Description};
use crate::error::SimError;
use crate::observation::Observation;
use crate::robot::Robot;
use crate::state::STATE_VERSION;
use crate::task::Task;

pub(super) fn describe(
    task: &Task,
    robot: &Robot,
    agents: &[Vec<usize>],
    observation: &Observation,
) -> Result<Description, SimError> {
    let state = task.rules.state_features(robot);
    let joints: Vec<&str> = robot.actuators().collect();
    let agents = agents.iter().enumerate().map(|(index, motors)| {
        Ok(AgentDescription {
            name: format!("agent_{index}"),
            joints: motors.iter().map(|&motor| joints[motor].to_owned()).collect(),
            observation: observation.features(&state),
            action: action_range(robot, motors)?,
        })
    });
    Ok(Description {
        task: task.name.to_owned(),
        agents: agents.collect::<Result<_, SimError>>()?,
        state,
        dt_secs: robot.step_secs(),
        episode_steps: task.episode_steps,
        state_kind: robot.state_kind(),
        state_version: STATE_VERSION,
        max_state_bytes: robot.state_bounds(task.episode_steps).bytes() as u32,
    })
}

/// One range for the whole action, so the agent's motors must share theirs.
fn action_range(robot: &Robot, motors: &[usize]) -> Result<ActionRange, SimError> {
    let ranges = motors.iter().map(|&motor| robot.layout().motors[motor].range);
    let mut ranges = ranges.collect::<Vec<_>>();
    ranges.dedup();
    match ranges.as_slice() {
        [[low, high]] => {
            Ok(ActionRange { size: motors.len(), low: *low, high: *high, choices: None })
        }
        _ => {
            let reason = format!("an agent's motors have {} control ranges", ranges.len());
            Err(SimError::Model { robot: robot.name().to_owned(), reason })
        }
    }
}
