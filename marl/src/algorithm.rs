//! What every learning rule offers to the learner, and the one place that chooses one.

use policy::{NamedArrays, PolicyConfig, PolicySnapshot, RunSeed};

use crate::batch::{Batch, Problem, Rewards};
use crate::config::{Config, Rule};
use crate::error::MarlError;
use crate::happo::Happo;

/// Figures of an update by name, in a fixed order.
pub type Report = Vec<(String, f64)>;

/// A learning rule: turns experience into better policies.
pub trait Algorithm: Send {
    /// Takes one update from the experience of iteration `iteration` and every agent's rewards
    /// `[N][T, B]`.
    ///
    /// # Errors
    /// Refuses a batch that does not fit the problem, naming what is wrong.
    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Rewards,
        iteration: u64,
    ) -> Result<Report, MarlError>;

    /// The policies to act with now.
    ///
    /// # Errors
    /// Passes on a tensor error.
    fn snapshot(&self) -> Result<PolicySnapshot, MarlError>;

    /// Everything that the next update depends on, under `weights/`, `optimizer/`, `normalizer/`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    fn arrays(&self) -> Result<NamedArrays, MarlError>;

    /// Takes over what [`Algorithm::arrays`] gave; arrays under other prefixes are not looked at.
    ///
    /// # Errors
    /// Names an array that is missing, unknown, or of another shape or type.
    fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError>;
}

/// The configured learning rule, its weights drawn with `seed`.
///
/// # Errors
/// Passes on a tensor error.
pub fn build(
    config: &Config,
    policy: &PolicyConfig,
    problem: &Problem,
    seed: RunSeed,
) -> Result<Box<dyn Algorithm>, MarlError> {
    match config.update.rule {
        Rule::Happo => Ok(Box::new(Happo::new(config, policy, problem, seed)?)),
    }
}
