//! Errors of this crate's public functions.

/// An invalid batch, configuration or stored state, or a failed computation.
#[derive(Debug, thiserror::Error)]
pub enum MarlError {
    /// A configuration value is outside its range.
    #[error("{key} = {found} is out of range: {range}")]
    Config {
        /// The key in the configuration file.
        key: &'static str,
        /// The value.
        found: String,
        /// The valid range.
        range: &'static str,
    },
    /// Agents with shared parameters have different sizes.
    #[error(
        "update.parameters = shared needs agents of equal sizes: agent 0 has {} observation \
         features and {} action dimensions, agent {other} has {} and {}; use separate",
        first.0, first.1, second.0, second.1
    )]
    Unequal {
        /// Observation features and action dimensions of agent 0.
        first: (usize, usize),
        /// Index of the agent that differs.
        other: usize,
        /// Observation features and action dimensions of that agent.
        second: (usize, usize),
    },
    /// An array of the batch has a length that does not match its shape.
    #[error("batch.{field} has {found} numbers; its shape {shape} needs {expected}")]
    Shape {
        /// Name of the array in the batch.
        field: String,
        /// The shape in words, such as `[T, B, obs]`.
        shape: &'static str,
        /// Length of that shape.
        expected: usize,
        /// Length of the array.
        found: usize,
    },
    /// The batch is inconsistent.
    #[error("batch: {0}")]
    Batch(String),
    /// The batch contains a number that is not finite.
    #[error("batch.{field}[{index}] is {found}")]
    NotFinite {
        /// Name of the array in the batch.
        field: String,
        /// Index in the array.
        index: usize,
        /// The number.
        found: f32,
    },
    /// A stored state has a missing or an additional array, or one of another shape or type.
    #[error("stored state: {0}")]
    Restore(String),
    /// The backward pass did not reach a parameter.
    #[error("parameter {0} has no gradient")]
    NoGradient(String),
    /// A tensor operation failed.
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
    /// The policy crate returned an error.
    #[error(transparent)]
    Policy(#[from] policy::PolicyError),
}
