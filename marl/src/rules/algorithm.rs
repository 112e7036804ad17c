//! The interface of learning rules.

use policy::{NamedArrays, PolicySnapshot};

use crate::data::batch::{Batch, Rewards};
use crate::error::MarlError;

/// Named metrics of an update, in a fixed order.
pub type Report = Vec<(String, f64)>;

/// Prefixes of the names of an algorithm's arrays.
pub const PREFIXES: [&str; 5] = ["weights/", "optimizer/", "normalizer/", "memory/", "replay/"];

/// A learning rule, which updates policies from rollout data.
pub trait Algorithm: Send {
    /// Sets the fraction of the configured learning rates of actors and critics for the next updates. It is not part of
    /// the stored state, so the caller sets it before every [`Algorithm::update`].
    fn scale_learning_rates(&mut self, share: f64);

    /// Updates the policies once with the rollout data of iteration `iteration` and every agent's rewards `[N][T, B]`.
    ///
    /// # Errors
    /// If the batch does not match the problem; the error names the first invalid array.
    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Rewards,
        iteration: u64,
    ) -> Result<Report, MarlError>;

    /// The current policies.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn snapshot(&self) -> Result<PolicySnapshot, MarlError>;

    /// The complete state of the next update, under [`PREFIXES`].
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn arrays(&self) -> Result<NamedArrays, MarlError>;

    /// The part of [`Algorithm::arrays`] under `weights/`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn weights(&self) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.arrays()?;
        arrays.retain(|name, _| name.starts_with("weights/"));
        Ok(arrays)
    }

    /// Restores the output of [`Algorithm::arrays`]. Arrays under other prefixes are ignored.
    ///
    /// # Errors
    /// Names an array that is missing, unknown, or of another shape or type.
    fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError>;
}

/// Rejects stored arrays of another algorithm.
pub(crate) fn reject_unknown(stored: &NamedArrays, known: &NamedArrays) -> Result<(), MarlError> {
    let own = |name: &&String| PREFIXES.iter().any(|prefix| name.starts_with(prefix));
    match stored.keys().filter(own).find(|name| !known.contains_key(*name)) {
        None => Ok(()),
        Some(name) => Err(MarlError::Restore(format!("{name} does not belong to this run"))),
    }
}
