//! What can go wrong between the world and its callers.

use thiserror::Error;

/// Why environments cannot be built, restored or stepped.
#[derive(Debug, Error)]
pub enum SimError {
    /// No such task.
    #[error("there is no task `{asked}`; did you mean `{nearest}`? Known tasks: {known}")]
    UnknownTask {
        /// The name asked for.
        asked: String,
        /// The known name that is nearest in spelling.
        nearest: String,
        /// All known names.
        known: String,
    },
    /// A slot without environments.
    #[error("a slot needs at least one environment, got 0")]
    NoEnvironments,
    /// A robot's MJCF file asks for what the builder does not build.
    #[error("the model of {robot} cannot be built: {reason}")]
    Model {
        /// The robot.
        robot: String,
        /// The element and what is wrong with it.
        reason: String,
    },
    /// A game shows its features one way only.
    #[error(
        "{task} shows plain one-hot features: observation.mode must be full_id and observation.norm none"
    )]
    OnlyPlain {
        /// The task.
        task: &'static str,
    },
    /// An encoded state is refused.
    #[error("the environment state is refused: {0}")]
    State(#[from] StateError),
    /// Actions are refused.
    #[error(transparent)]
    Action(#[from] ActionError),
    /// Environments outside this process cannot be reached, or answer wrongly.
    #[error(transparent)]
    External(Box<dyn std::error::Error + Send + Sync>),
}

/// Actions that no robot can follow; nothing has moved.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ActionError {
    /// Not one number per environment and action dimension.
    #[error("{got} numbers of actions, {environments} environments need {environments} x {size}")]
    Length {
        /// Numbers received.
        got: usize,
        /// Environments in the slot.
        environments: usize,
        /// Numbers in all agents' joint action.
        size: usize,
    },
    /// A number that is not finite.
    #[error("the action of agent {agent} in environment {environment} is {value} at index {index}")]
    NotFinite {
        /// Place of the environment in the slot.
        environment: usize,
        /// The agent.
        agent: usize,
        /// Place in the agent's action.
        index: usize,
        /// The number.
        value: f32,
    },
    /// A number that is no choice's index.
    #[error(
        "the action of agent {agent} in environment {environment} is {value}, not one of {choices} choices"
    )]
    NoChoice {
        /// Place of the environment in the slot.
        environment: usize,
        /// The agent.
        agent: usize,
        /// The number.
        value: f32,
        /// Choices there are; the first one's index is 0.
        choices: usize,
    },
}

/// Why an encoded state is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum StateError {
    /// Not the one length that a state of this robot has.
    #[error("it has {got} bytes, a state of {kind} has {expected}")]
    Length {
        /// Bytes received.
        got: usize,
        /// Bytes of a state.
        expected: usize,
        /// The state's kind.
        kind: String,
    },
    /// The first four bytes are not a state's.
    #[error("it does not begin with the mark of a state")]
    Mark,
    /// Another version of the layout.
    #[error("its layout has version {got}, this program reads {expected}")]
    Version {
        /// Version received.
        got: u32,
        /// Version that this program reads.
        expected: u32,
    },
    /// Another robot's state.
    #[error("it belongs to another robot than {kind}")]
    Kind {
        /// The kind expected.
        kind: String,
    },
    /// An episode limit that the task does not allow.
    #[error("its episode limit is {limit}, allowed are 1 to {longest}")]
    Limit {
        /// Limit received.
        limit: u32,
        /// The task's own limit.
        longest: u32,
    },
    /// An episode that is already over.
    #[error("its episode is over: step {step} of {limit}")]
    Over {
        /// Step received.
        step: u32,
        /// The episode's limit.
        limit: u32,
    },
    /// A NaN or an infinity.
    #[error("{field} {index} is not finite")]
    NotFinite {
        /// `coordinate` or `velocity`.
        field: &'static str,
        /// Which one.
        index: usize,
    },
    /// A number no simulated world reaches.
    #[error("{field} {index} is {value}, beyond {low} to {high}")]
    Beyond {
        /// `coordinate` or `velocity`.
        field: &'static str,
        /// Which one.
        index: usize,
        /// Value received.
        value: f32,
        /// Lowest value allowed.
        low: f32,
        /// Highest value allowed.
        high: f32,
    },
    /// A number that counts something is no whole number.
    #[error("{field} {index} is {value}, not a whole number")]
    Fraction {
        /// `coordinate` or `velocity`.
        field: &'static str,
        /// Which one.
        index: usize,
        /// Value received.
        value: f32,
    },
    /// The orientation is no unit quaternion.
    #[error("the orientation at coordinate {index} has squared length {squared}, not 1")]
    Orientation {
        /// Its first coordinate.
        index: usize,
        /// Its squared length.
        squared: f32,
    },
    /// Not a state of this external environment.
    #[error("{0}")]
    External(String),
}
