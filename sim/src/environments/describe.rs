//! Builds a task's description from the task and its partition, and maps actions to controls.

use proto::{ActionSpec, AgentSpec, EnvironmentSpec, FeatureRole};

use crate::config::ObservationConfig;
use crate::error::SimError;
use crate::observation::{self, GlobalState, Observation, contact_features};
use crate::robot::Actuator;
use crate::state::{STATE_VERSION, StateBounds};
use crate::task::{Audience, Task};

pub(super) fn describe(
    task: &Task,
    config: &ObservationConfig,
    bounds: &StateBounds,
) -> (EnvironmentSpec, Observation) {
    let robot = &task.robot;
    let state = global_state(task, config);
    let actuators: Vec<Actuator<'_>> = robot.actuators().collect();
    let observation = Observation::new(config, robot, &task.agents, &state);
    let seen = |index: usize| {
        if task.rules.disturbance.change_sensors() { Vec::new() } else { observation.seen(index) }
    };
    let agents = task.agents.iter().enumerate().map(|(index, motors)| AgentSpec {
        name: format!("agent_{index}"),
        joints: motors.iter().map(|&motor| actuators[motor].joint.to_owned()).collect(),
        observation: observation.features(index, &state.features),
        seen: seen(index),
        near: observation::near(config, robot, motors, &state),
        action: ActionSpec::continuous(motors.len()),
    });
    let description = EnvironmentSpec {
        task: task.name.clone(),
        agents: agents.collect(),
        state: state.features,
        dt_secs: robot.step_secs(),
        episode_steps: task.episode_steps,
        state_kind: bounds.kind.clone(),
        state_version: STATE_VERSION,
        max_state_bytes: bounds.bytes() as u32,
        feature_z: false,
        reward_terms: task.rules.term_names.clone(),
    };
    (description, observation)
}

/// Refuses an agent that observes nothing, as with local observations one whose motors move no joint.
pub(super) fn check_sight(description: &EnvironmentSpec) -> Result<(), SimError> {
    let is_blind =
        |agent: &&AgentSpec| agent.observation.iter().all(|own| own.role == FeatureRole::Constant);
    match description.agents.iter().find(is_blind) {
        None => Ok(()),
        Some(AgentSpec { name, .. }) => Err(SimError::Task(format!(
            "{}: with observation.mode=k_nearest {name} observes nothing; name features in [neighbourhood] `globals`, or add \
             [[state.bodies]]",
            description.task
        ))),
    }
}

/// The global state: measured features, command, contact forces, disturbances.
fn global_state(task: &Task, config: &ObservationConfig) -> GlobalState {
    let rules = &task.rules;
    let mut features = rules.measured_features(&task.robot);
    let command = features.len();
    features.extend(rules.command.features());
    let mut shared: Vec<usize> = (command..features.len()).collect();
    features.extend(contact_features(&task.robot, config.contact_forces));
    let disturbances = features.len();
    features.extend(rules.disturbance_features());
    let shows_disturbances = rules.audience == Audience::Agents;
    let observed = if shows_disturbances { features.len() } else { disturbances };
    shared.extend(disturbances..observed);
    let related = rules.related(&task.robot);
    GlobalState { features, observed, shared, related }
}

/// A motor that a component of the joint action drives.
pub(super) struct Driven {
    /// Index of the motor.
    pub(super) motor: usize,
    /// Controls for the actions -1 and 1.
    pub(super) range: [f32; 2],
}

impl Driven {
    /// The control of an action within -1 to 1 that is nearest to `control`.
    pub(super) fn limited(&self, control: f32) -> f32 {
        control.clamp(self.range[0], self.range[1])
    }

    /// Motors of all agents, in agent order, `[A]`.
    pub(super) fn all(task: &Task) -> Vec<Self> {
        let driven = |&motor: &usize| Self { motor, range: task.control_ranges[motor] };
        task.agents.iter().flatten().map(driven).collect()
    }
}
