//! Builds a task's description from the task and its partition.

use crate::config::ObservationConfig;
use crate::description::{ActionRange, AgentDescription, Description};
use crate::error::SimError;
use crate::observation::{self, Observation, contact_features};
use crate::robot::Robot;
use crate::state::{STATE_VERSION, StateBounds};
use crate::task::Task;

pub(super) fn describe(
    task: &Task,
    agents: &[Vec<usize>],
    config: &ObservationConfig,
    bounds: &StateBounds,
) -> Result<(Description, Observation), SimError> {
    let robot = &task.robot;
    let mut state = task.rules.state_features(robot);
    state.extend(contact_features(robot, config.contact_forces));
    let joints: Vec<&str> = robot.actuators().collect();
    let driven: Vec<Vec<&str>> =
        agents.iter().map(|motors| motors.iter().map(|&motor| joints[motor]).collect()).collect();
    let observation = Observation::new(config, robot, &driven, &state);
    let agents = agents.iter().enumerate().map(|(index, motors)| {
        Ok(AgentDescription {
            name: format!("agent_{index}"),
            joints: motors.iter().map(|&motor| joints[motor].to_owned()).collect(),
            observation: observation.features(index, &state),
            seen: observation.seen(index, state.len()),
            near: observation::near(config, robot, &driven[index], &state),
            action: action_range(robot, motors)?,
        })
    });
    let description = Description {
        task: task.name.clone(),
        agents: agents.collect::<Result<_, SimError>>()?,
        state,
        dt_secs: robot.step_secs(),
        episode_steps: task.episode_steps,
        state_kind: bounds.kind.clone(),
        state_version: STATE_VERSION,
        max_state_bytes: bounds.bytes() as u32,
    };
    Ok((description, observation))
}

/// The control range of an agent's action, which must be the same for all its motors.
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
