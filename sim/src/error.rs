//! Errors of environments, actions and encoded states.

use std::fmt::{Display, LowerExp};

use thiserror::Error;

/// A number for a message, with an exponent if it is very large or small.
pub(crate) fn short<T: Copy + Display + LowerExp + Into<f64>>(number: T) -> String {
    let size = number.into().abs();
    let is_plain = size == 0.0 || (1e-4..1e6).contains(&size) || !size.is_finite();
    if is_plain { number.to_string() } else { format!("{number:e}") }
}

/// Why environments cannot be built, restored or stepped.
#[derive(Debug, Error)]
pub enum SimError {
    /// The task is unknown, its file is invalid, or it does not support the settings; in words.
    #[error("{0}")]
    Task(String),
    /// The slot has no environments.
    #[error("a slot needs at least one environment, got 0")]
    NoEnvironments,
    /// A robot's MJCF file contains something that the builder does not support.
    #[error("the model of {robot} cannot be built: {reason}")]
    Model {
        /// The robot.
        robot: String,
        /// The element and the reason.
        reason: String,
    },
    /// An encoded state is invalid.
    #[error("invalid environment state: {0}")]
    State(#[from] StateError),
    /// The actions are invalid.
    #[error(transparent)]
    Action(#[from] ActionError),
    /// An environment outside this process cannot be reached or sent an invalid answer.
    #[error(transparent)]
    External(Box<dyn std::error::Error + Send + Sync>),
}

/// Why actions are invalid. No environment has been stepped.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ActionError {
    /// Wrong number of values.
    #[error("got {got} action values; {environments} environments need {environments} x {size}")]
    Length {
        /// Values received.
        got: usize,
        /// Environments in the slot.
        environments: usize,
        /// Size of the joint action of all agents.
        size: usize,
    },
    /// A value is not finite or too large.
    #[error(
        "the action of agent {agent} in environment {environment} is {} at index {index}; it must be a number from -1e6 to 1e6",
        short(*.value)
    )]
    Beyond {
        /// Index of the environment in the slot.
        environment: usize,
        /// The agent.
        agent: usize,
        /// Index in the agent's action.
        index: usize,
        /// Value received.
        value: f32,
    },
    /// A value is not the index of a choice.
    #[error(
        "the action of agent {agent} in environment {environment} is {value}, not one of {choices} choices"
    )]
    NoChoice {
        /// Index of the environment in the slot.
        environment: usize,
        /// The agent.
        agent: usize,
        /// Value received.
        value: f32,
        /// Number of choices; indices start at 0.
        choices: usize,
    },
}

/// Why an encoded state is invalid.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum StateError {
    /// Wrong length.
    #[error("it has {got} bytes; a state of {kind} has {expected}")]
    Length {
        /// Bytes received.
        got: usize,
        /// Bytes of a state.
        expected: usize,
        /// Expected kind.
        kind: String,
    },
    /// Wrong magic bytes.
    #[error("it does not start with the magic bytes of a state")]
    Mark,
    /// Unsupported layout version.
    #[error("its layout version is {got}; this program reads {expected}")]
    Version {
        /// Version received.
        got: u32,
        /// Version that this program reads.
        expected: u32,
    },
    /// State of another robot.
    #[error("it is not a state of {kind}")]
    Kind {
        /// The kind expected.
        kind: String,
    },
    /// The task does not allow this episode limit.
    #[error("its episode limit is {limit}; it must be 1 to {longest}")]
    Limit {
        /// Limit received.
        limit: u32,
        /// Episode limit of the task.
        longest: u32,
    },
    /// The episode is already over.
    #[error("its episode is over: step {step} of {limit}")]
    Over {
        /// Step received.
        step: u32,
        /// The episode's limit.
        limit: u32,
    },
    /// A value is NaN or infinite.
    #[error("{field} {index} is not finite")]
    NotFinite {
        /// `coordinate`, `velocity`, `activation`, `action` or `measurement`.
        field: &'static str,
        /// Index of the value.
        index: usize,
    },
    /// A value is out of bounds.
    #[error("{field} {index} is {value}; it must be between {low} and {high}")]
    Beyond {
        /// `coordinate`, `velocity`, `activation`, `action` or `measurement`.
        field: &'static str,
        /// Index of the value.
        index: usize,
        /// Value received.
        value: f32,
        /// Lowest value allowed.
        low: f32,
        /// Highest value allowed.
        high: f32,
    },
    /// An integer value has a fraction.
    #[error("{field} {index} is {value}, not a whole number")]
    Fraction {
        /// `coordinate`, `velocity`, `activation`, `action` or `measurement`.
        field: &'static str,
        /// Index of the value.
        index: usize,
        /// Value received.
        value: f32,
    },
    /// The orientation is not a unit quaternion.
    #[error("the orientation at coordinate {index} has squared length {squared}, not 1")]
    Orientation {
        /// Index of its first coordinate.
        index: usize,
        /// Its squared length.
        squared: f32,
    },
    /// The number that says whether its episode is disturbed is neither 0 nor 1.
    #[error("the number that says whether it is disturbed is {got}, not 0 or 1")]
    Disturbed {
        /// Number received.
        got: u32,
    },
    /// The bytes are not a state of this external environment.
    #[error("{0}")]
    External(String),
}
