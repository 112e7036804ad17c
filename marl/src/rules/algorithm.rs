//! What every learning rule offers to the learner.

use policy::{NamedArrays, PolicySnapshot};

use crate::data::batch::{Batch, Rewards};
use crate::error::MarlError;

/// Figures of an update by name, in a fixed order.
pub type Report = Vec<(String, f64)>;

/// The first parts of the names of an algorithm's arrays.
pub const PREFIXES: [&str; 4] = ["weights/", "optimizer/", "normalizer/", "replay/"];

/// A learning rule: turns experience into better policies.
pub trait Algorithm: Send {
    /// From now on actors and critics step with the share `share` of their configured step sizes. Whoever calls
    /// [`Algorithm::update`] says so before; it is no part of the state.
    fn scale_learning_rates(&mut self, share: f64);

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

/// Refuses stored arrays of an algorithm that this one does not have.
pub(crate) fn refuse_strange(stored: &NamedArrays, known: &NamedArrays) -> Result<(), MarlError> {
    let own = |name: &&String| PREFIXES.iter().any(|prefix| name.starts_with(prefix));
    match stored.keys().filter(own).find(|name| !known.contains_key(*name)) {
        None => Ok(()),
        Some(name) => Err(MarlError::Restore(format!("{name} belongs to nothing in this run"))),
    }
}
