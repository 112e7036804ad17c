//! Builds a task's description from the task and its partition, and maps actions to controls.

use proto::{ActionSpec, AgentSpec, EnvironmentSpec};

use crate::action_scale::ActionScale;
use crate::config::ObservationConfig;
use crate::observation::{self, Observation, contact_features};
use crate::state::{STATE_VERSION, StateBounds};
use crate::task::Task;

pub(super) fn describe(
    task: &Task,
    config: &ObservationConfig,
    bounds: &StateBounds,
) -> (EnvironmentSpec, Observation) {
    let robot = &task.robot;
    let mut state = task.rules.state_features(robot);
    state.extend(contact_features(robot, config.contact_forces));
    let joints: Vec<&str> = robot.actuators().map(|actuator| actuator.joint).collect();
    let driven: Vec<Vec<&str>> = task
        .agents
        .iter()
        .map(|motors| motors.iter().map(|&motor| joints[motor]).collect())
        .collect();
    let observation = Observation::new(config, robot, &driven, &state);
    let agents = task.agents.iter().enumerate().map(|(index, motors)| AgentSpec {
        name: format!("agent_{index}"),
        joints: motors.iter().map(|&motor| joints[motor].to_owned()).collect(),
        observation: observation.features(index, &state),
        seen: observation.seen(index, state.len()),
        near: observation::near(config, robot, &driven[index], &state),
        action: ActionSpec::continuous(motors.len()),
    });
    let description = EnvironmentSpec {
        task: task.name.clone(),
        agents: agents.collect(),
        state,
        dt_secs: robot.step_secs(),
        episode_steps: task.episode_steps,
        state_kind: bounds.kind.clone(),
        state_version: STATE_VERSION,
        max_state_bytes: bounds.bytes() as u32,
        feature_z: false,
    };
    (description, observation)
}

/// A motor that a component of the joint action drives.
pub(super) struct Driven {
    /// Index of the motor.
    pub(super) motor: usize,
    /// Controls for the actions -1 and 1.
    pub(super) range: [f32; 2],
    /// Map from the action to the motor's control.
    pub(super) scale: ActionScale,
}

impl Driven {
    /// Motors of all agents, in agent order, `[A]`.
    pub(super) fn all(task: &Task) -> Vec<Self> {
        let driven = |&motor: &usize| {
            let range = task.controls.ranges[motor];
            Self { motor, range, scale: ActionScale::to(range) }
        };
        task.agents.iter().flatten().map(driven).collect()
    }
}
