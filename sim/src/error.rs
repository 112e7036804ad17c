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
    /// The actions are invalid, in words. No environment has been stepped.
    #[error("{0}")]
    Action(String),
    /// An environment outside this process cannot be reached or sent an invalid answer.
    #[error(transparent)]
    External(Box<dyn std::error::Error + Send + Sync>),
}

/// Why an encoded state is invalid, in words.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct StateError(pub String);
