//! The interface of vectorised environments, which `sim` or another program steps.

use proto::{ActuatorSpec, AgentSpec, EnvironmentSpec, EpisodePosition, LARGEST_ACTION};

use crate::config::TaskConfig;
use crate::environments::RobotEnvironments;
use crate::error::{SimError, short};
use crate::game::cue::Cue;
use crate::game::jump::Jump;
use crate::game::signal::Signal;
use crate::game::{Game, GameEnvironments};
use crate::robot::Robot;
use crate::scene::Pose;
use crate::state::StateBounds;
use crate::world::World;

/// Returns `count` environments of a task, of a simulated robot or a game, in their rest state, in episode 0.
///
/// # Errors
/// If the task is unknown or does not allow these settings, or `count` is 0.
pub fn environments(
    config: &TaskConfig,
    count: usize,
) -> Result<Box<dyn EnvironmentBatch>, SimError> {
    if count == 0 {
        return Err(SimError::NoEnvironments);
    }
    Ok(match config.task.as_str() {
        Cue::NAME => Box::new(GameEnvironments::<Cue>::new(config, count)?),
        Jump::NAME => Box::new(GameEnvironments::<Jump>::new(config, count)?),
        Signal::NAME => Box::new(GameEnvironments::<Signal>::new(config, count)?),
        _ => Box::new(RobotEnvironments::new(config, count)?),
    })
}

/// The environments of a slot. Observations, states and rewards depend only on the reset key, the restored state and
/// the actions. Environments outside this process fail with [`SimError::External`].
pub trait EnvironmentBatch: Send {
    /// Description of the task.
    fn description(&self) -> &EnvironmentSpec;

    /// Number of environments `E`.
    fn count(&self) -> usize;

    /// Starts an episode. `key` is the ChaCha8 key that draws its start state. `limit` is the number of steps until
    /// truncation, clamped to `1..=episode_steps`.
    ///
    /// # Errors
    /// If an external environment fails.
    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: [u8; 32],
    ) -> Result<(), SimError>;

    /// Selects which episodes that start from now on are disturbed; at first those of training are. Does nothing unless the
    /// task states disturbances.
    fn set_disturbances(&mut self, _disturbances: Disturbances) {}

    /// Whether the task states disturbances.
    fn can_be_disturbed(&self) -> bool {
        false
    }

    /// What an episode draws besides its start: command and disturbances, one line each.
    fn drawn(&self) -> Vec<String> {
        Vec::new()
    }

    /// Restores an encoded state. Invalid bytes change nothing.
    ///
    /// # Errors
    /// If the bytes are not a state of this task, or an external environment fails.
    fn restore(&mut self, environment: usize, state: &[u8]) -> Result<(), SimError>;

    /// Encodes the state of an environment. [`Self::restore`] rejects states of finished episodes, so reset first.
    ///
    /// # Errors
    /// If an external environment fails.
    fn encode(&self, environment: usize) -> Result<Vec<u8>, SimError>;

    /// As [`Self::restore`], for several environments, each with its state.
    ///
    /// # Errors
    /// As [`Self::restore`]. Some of the environments may have been restored.
    fn restore_all(&mut self, states: &[(usize, &[u8])]) -> Result<(), SimError> {
        states.iter().try_for_each(|(environment, state)| self.restore(*environment, state))
    }

    /// As [`Self::encode`], for every environment.
    ///
    /// # Errors
    /// As [`Self::encode`].
    fn encode_all(&self) -> Result<Vec<Vec<u8>>, SimError> {
        (0..self.count()).map(|environment| self.encode(environment)).collect()
    }

    /// Position of an environment in its episode.
    fn position(&self, environment: usize) -> EpisodePosition;

    /// Steps every environment. `actions` is `[E, A]`; a row has the actions of all agents in agent order. `outcome` is
    /// `[E]`. A finished episode is not reset, so that the caller can read its last observation and state.
    ///
    /// # Errors
    /// If `actions` has a wrong length or contains an invalid action (no environment is stepped), or an external
    /// environment fails.
    ///
    /// # Panics
    /// If `outcome` has a wrong length.
    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), SimError>;

    /// Writes the observation of an agent, `[obs]`.
    ///
    /// # Panics
    /// If `out` has a wrong length.
    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]);

    /// Writes the global state, `[S]`.
    ///
    /// # Panics
    /// If `out` has a wrong length.
    fn state(&self, environment: usize, out: &mut [f32]);

    /// The global state, `[S]`.
    fn state_of(&self, environment: usize) -> Vec<f32> {
        let mut state = vec![0.0; self.description().state.len()];
        self.state(environment, &mut state);
        state
    }

    /// The observation of each agent, `[obs]`.
    fn observations_of(&self, environment: usize) -> Vec<Vec<f32>> {
        let agents = self.description().agents.iter().enumerate();
        let observe = |(agent, spec): (usize, &AgentSpec)| {
            let mut row = vec![0.0; spec.observation.len()];
            self.observation(environment, agent, &mut row);
            row
        };
        agents.map(observe).collect()
    }

    /// Terms of the reward of the last step, with their weights, costs negative, `[K]` in the order of
    /// [`EnvironmentSpec::reward_terms`]. After a fault and after a reset, all are 0.
    fn reward_terms(&self, _environment: usize) -> &[f32] {
        &[]
    }

    /// Poses of a simulated robot's links and joints; empty for games and external environments.
    fn pose(&self, _environment: usize) -> Pose {
        Pose::default()
    }

    /// The physics world of a simulated robot, for measurements; `None` for games and external environments.
    fn world(&self, _environment: usize) -> Option<&World> {
        None
    }

    /// The simulated robot; `None` for games and external environments.
    fn robot(&self) -> Option<&Robot> {
        self.world(0).map(World::robot)
    }

    /// What makes the task of a simulated robot hard to learn, one sentence each with what to change; empty for games and
    /// external environments.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    /// Controls to which the actions -1 and 1 of an agent of a simulated robot are mapped, one pair for each number of its
    /// action; empty for games and external environments.
    fn control_ranges(&self, _agent: usize) -> Vec<[f32; 2]> {
        Vec::new()
    }

    /// Actuators of a simulated robot that the numbers of an agent's action control; empty for games and external environments.
    fn actuators(&self, _agent: usize) -> Vec<ActuatorSpec> {
        Vec::new()
    }

    /// Bounds of an encoded state; `None` for external environments.
    fn state_bounds(&self) -> Option<&StateBounds> {
        None
    }
}

/// An action in units of half a range, in the range's own unit, such as that of a motor's control; not clamped. For the range
/// -1 to 1 this is exactly the action.
pub fn in_range([low, high]: [f32; 2], action: f32) -> f32 {
    (low / 2.0 + high / 2.0) + (high / 2.0 - low / 2.0) * action
}

/// Checks actions `[E, A]` of `environments` environments of a task: their number, that continuous ones are numbers of at most
/// 1e6, and that discrete ones are indices of choices.
///
/// # Errors
/// The first action that is invalid.
pub fn check_actions(
    task: &EnvironmentSpec,
    environments: usize,
    actions: &[f32],
) -> Result<(), SimError> {
    let got = actions.len();
    let size: usize = task.agents.iter().map(|agent| agent.action.size).sum();
    if got != environments * size {
        return Err(SimError::Action(format!(
            "got {got} action values; {environments} environments need {environments} x {size}"
        )));
    }
    let is_valid = |choices: Option<u32>, value: f32| match choices {
        Some(choices) => (0.0..choices as f32).contains(&value) && value.fract() == 0.0,
        None => value.abs() <= LARGEST_ACTION,
    };
    let mut rest = actions.iter();
    for environment in 0..environments {
        for (agent, spec) in task.agents.iter().enumerate() {
            let choices = spec.action.choices;
            let mut own = rest.by_ref().take(spec.action.size).enumerate();
            let Some((index, &value)) = own.find(|(_, value)| !is_valid(choices, **value)) else {
                continue;
            };
            let why = match choices {
                Some(choices) => format!("{value}, not one of {choices} choices"),
                None => {
                    let value = short(value);
                    format!("{value} at index {index}; it must be a number from -1e6 to 1e6")
                }
            };
            let place = format!("the action of agent {agent} in environment {environment}");
            return Err(SimError::Action(format!("{place} is {why}")));
        }
    }
    Ok(())
}

/// Selection of the episodes that the disturbances of a task file act in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disturbances {
    /// All, as in training.
    AsInTraining,
    /// None, unless the task file states that evaluations are disturbed.
    AsInEvaluations,
    /// None.
    Off,
}

/// Result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The task's reward; 0 on a fault.
    pub reward: f32,
    /// The task's rules ended the episode.
    pub terminated: bool,
    /// The step limit or a fault ended the episode; never true together with `terminated`.
    pub truncated: bool,
    /// The state became non-finite or out of bounds. The environment is back in the state before the step.
    pub fault: bool,
}

impl Outcome {
    /// Whether the step ended the episode.
    pub fn is_end(&self) -> bool {
        self.terminated || self.truncated
    }
}
