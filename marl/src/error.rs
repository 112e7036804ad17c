//! What can go wrong at the edge of this crate, with the figures in it.

/// Why a batch, a configuration or a stored state was refused, or a computation failed.
#[derive(Debug, thiserror::Error)]
pub enum MarlError {
    /// A configuration value is outside its range.
    #[error("{key} = {found} is out of range: {range}")]
    Config {
        /// The key as it stands in the configuration file.
        key: &'static str,
        /// The value found.
        found: String,
        /// What is allowed.
        range: &'static str,
    },
    /// Agents should share their parameters and have different sizes.
    #[error(
        "update.parameters = shared needs agents of equal sizes: agent 0 has {} observation \
         features and {} action dimensions, agent {other} has {} and {}; use separate",
        first.0, first.1, second.0, second.1
    )]
    Unequal {
        /// Observation features and action dimensions of the first agent.
        first: (usize, usize),
        /// The agent that differs.
        other: usize,
        /// Its observation features and action dimensions.
        second: (usize, usize),
    },
    /// An array of the batch has another length than its shape asks for.
    #[error("batch.{field} has {found} numbers, its shape {shape} asks for {expected}")]
    Shape {
        /// The array's place in the batch.
        field: String,
        /// The shape in words, such as `[T, B, obs]`.
        shape: &'static str,
        /// Numbers that the shape asks for.
        expected: usize,
        /// Numbers found.
        found: usize,
    },
    /// The batch contradicts itself.
    #[error("batch: {0}")]
    Batch(String),
    /// The batch holds a number that is not finite.
    #[error("batch.{field}[{index}] is {found}")]
    NotFinite {
        /// The array's place in the batch.
        field: String,
        /// The number's place in the array.
        index: usize,
        /// The number.
        found: f32,
    },
    /// A stored state lacks an array, has one too many, or one of another shape or type.
    #[error("stored state: {0}")]
    Restore(String),
    /// A parameter got no gradient, although the loss depends on it.
    #[error("parameter {0} has no gradient")]
    NoGradient(String),
    /// A tensor operation failed.
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
    /// The policy crate refused something.
    #[error(transparent)]
    Policy(#[from] policy::PolicyError),
}
