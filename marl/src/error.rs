//! Errors of this crate's public functions.

/// An invalid batch or stored state, or a failed computation.
#[derive(Debug, thiserror::Error)]
pub enum MarlError {
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
    /// Training cannot begin from these policies.
    #[error("policy.start: {0}")]
    Start(String),
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
