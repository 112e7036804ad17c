//! What every learning rule offers to the learner, and the one place that chooses one.

use std::sync::Arc;

use policy::{NamedArrays, PolicyConfig, PolicySnapshot, Precision, RunSeed};

use crate::batch::{Batch, Problem, Rewards};
use crate::config::{Config, Rule};
use crate::error::MarlError;
use crate::happo::Happo;
use crate::maddpg::Maddpg;
use crate::mappo::Mappo;
use crate::phase::PhaseObserver;

/// Figures of an update by name, in a fixed order.
pub type Report = Vec<(String, f64)>;

/// The first parts of the names of an algorithm's arrays.
pub const PREFIXES: [&str; 4] = ["weights/", "optimizer/", "normalizer/", "replay/"];

/// A learning rule: turns experience into better policies.
pub trait Algorithm: Send {
    /// From now on actors and critics step with the share `share` of their configured step sizes. Whoever calls
    /// [`Algorithm::update`] says so before; it is no part of the state.
    fn scale_learning_rates(&mut self, share: f64);

    /// From now on `observer` is told of the parts of every update. A rule without these parts tells nothing.
    fn observe_phases(&mut self, _observer: Arc<dyn PhaseObserver>) {}

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

    /// Everything that the next update depends on, under [`PREFIXES`].
    ///
    /// # Errors
    /// Passes on a tensor error.
    fn arrays(&self) -> Result<NamedArrays, MarlError>;

    /// The part of [`Algorithm::arrays`] under `weights/`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    fn weights(&self) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.arrays()?;
        arrays.retain(|name, _| name.starts_with("weights/"));
        Ok(arrays)
    }

    /// Takes over what [`Algorithm::arrays`] gave; arrays under other prefixes are not looked at.
    ///
    /// # Errors
    /// Names an array that is missing, unknown, or of another shape or type.
    fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError>;
}

/// The configured learning rule, its weights drawn with `seed`.
///
/// # Errors
/// Refuses settings that do not suit each other or the problem; passes on a tensor error.
pub fn build(
    config: &Config,
    policy: &PolicyConfig,
    problem: &Problem,
    seed: RunSeed,
) -> Result<Box<dyn Algorithm>, MarlError> {
    build_in(Precision::Single, config, policy, problem, seed)
}

/// As [`build`], in any precision.
///
/// # Errors
/// As [`build`].
pub fn build_in(
    precision: Precision,
    config: &Config,
    policy: &PolicyConfig,
    problem: &Problem,
    seed: RunSeed,
) -> Result<Box<dyn Algorithm>, MarlError> {
    let start = (seed, precision);
    config.suits(policy)?;
    config.suits_agents(problem)?;
    match config.update.rule {
        Rule::Happo => Ok(Box::new(Happo::new(config, policy, problem, start)?)),
        Rule::Mappo => Ok(Box::new(Mappo::new(config, policy, problem, start)?)),
        Rule::Maddpg => Ok(Box::new(Maddpg::new(config, policy, problem, start)?)),
    }
}

/// Refuses stored arrays of an algorithm that this one does not have.
pub(crate) fn refuse_strange(stored: &NamedArrays, known: &NamedArrays) -> Result<(), MarlError> {
    let own = |name: &&String| PREFIXES.iter().any(|prefix| name.starts_with(prefix));
    match stored.keys().filter(own).find(|name| !known.contains_key(*name)) {
        None => Ok(()),
        Some(name) => Err(MarlError::Restore(format!("{name} belongs to nothing in this run"))),
    }
}

#[cfg(test)]
mod tests;
