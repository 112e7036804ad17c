//! Builds a task's description from the task and its partition, and maps actions to controls.

use crate::config::ObservationConfig;
use crate::description::{ActionRange, AgentDescription, Description};
use crate::observation::{self, Observation, contact_features};
use crate::robot::Robot;
use crate::state::{STATE_VERSION, StateBounds};
use crate::task::Task;

pub(super) fn describe(
    task: &Task,
    agents: &[Vec<usize>],
    config: &ObservationConfig,
    bounds: &StateBounds,
) -> (Description, Observation) {
    let robot = &task.robot;
    let mut state = task.rules.state_features(robot);
    state.extend(contact_features(robot, config.contact_forces));
    let joints: Vec<&str> = robot.actuators().collect();
    let driven: Vec<Vec<&str>> =
        agents.iter().map(|motors| motors.iter().map(|&motor| joints[motor]).collect()).collect();
    let observation = Observation::new(config, robot, &driven, &state);
    let agents = agents.iter().enumerate().map(|(index, motors)| AgentDescription {
        name: format!("agent_{index}"),
        joints: motors.iter().map(|&motor| joints[motor].to_owned()).collect(),
        observation: observation.features(index, &state),
        seen: observation.seen(index, state.len()),
        near: observation::near(config, robot, &driven[index], &state),
        action: action_range(robot, motors),
    });
    let description = Description {
        task: task.name.clone(),
        agents: agents.collect(),
        state,
        dt_secs: robot.step_secs(),
        episode_steps: task.episode_steps,
        state_kind: bounds.kind.clone(),
        state_version: STATE_VERSION,
        max_state_bytes: bounds.bytes() as u32,
    };
    (description, observation)
}

/// Range of an agent's actions: that of the controls of its motors if all have the same, else -1 to 1.
fn action_range(robot: &Robot, motors: &[usize]) -> ActionRange {
    let [low, high] = same_range(robot, motors).unwrap_or([-1.0, 1.0]);
    ActionRange { size: motors.len(), low, high, choices: None }
}

/// The control range of these motors, if they have only one.
fn same_range(robot: &Robot, motors: &[usize]) -> Option<[f32; 2]> {
    let mut ranges = motors.iter().map(|&motor| robot.layout().motors[motor].range);
    let first = ranges.next()?;
    ranges.all(|range| range == first).then_some(first)
}

/// A motor that a component of the joint action drives.
pub(super) struct Driven {
    /// Index of the motor.
    pub(super) motor: usize,
    /// Middle and half the width of its control range, if the agent's motors have several; its actions are in -1 to 1 then.
    scale: Option<[f32; 2]>,
}

impl Driven {
    /// Motors of all agents, in agent order, `[A]`.
    pub(super) fn all(robot: &Robot, agents: &[Vec<usize>]) -> Vec<Self> {
        let of_agent = |motors: &Vec<usize>| {
            let same = same_range(robot, motors).is_some();
            let driven = |&motor: &usize| {
                let [low, high] = robot.layout().motors[motor].range;
                let scale = [low / 2.0 + high / 2.0, high / 2.0 - low / 2.0];
                Self { motor, scale: (!same).then_some(scale) }
            };
            motors.iter().map(driven).collect::<Vec<_>>()
        };
        agents.iter().flat_map(of_agent).collect()
    }

    /// Control for an action: the action itself, or `middle + half width x action`. Not clamped.
    pub(super) fn control(&self, action: f32) -> f32 {
        self.scale.map_or(action, |[middle, half]| middle + half * action)
    }
}
