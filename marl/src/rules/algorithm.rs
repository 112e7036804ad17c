//! The interface of learning rules.

use policy::{NamedArrays, PolicySnapshot};

use crate::data::batch::Batch;
use crate::error::MarlError;
use crate::state::StoredState;
use crate::surprise::Relabelled;

/// Named metrics of an update, in a fixed order.
pub type Report = Vec<(String, f64)>;

/// Prefixes of the names of an algorithm's arrays.
pub(crate) const PREFIXES: [&str; 5] =
    ["weights/", "optimizer/", "normalizer/", "memory/", "replay/"];

/// A learning rule, which updates policies from rollout data. Its state is that of the next update.
pub trait Algorithm: StoredState + Send {
    /// Sets the fraction of the configured learning rates of actors and critics for the next updates. It is not part of
    /// the stored state, so the caller sets it before every [`Algorithm::update`].
    fn scale_learning_rates(&mut self, share: f64);

    /// Sets the fraction of the loadings of noise that agents share, for the next [`Algorithm::snapshot`] and the update with
    /// what its policies do. It is not part of the stored state, so the caller sets it before every snapshot.
    fn scale_noise(&mut self, share: f64);

    /// Learns that the next rollout begins a new episode in this environment, although the last one ended in the middle of an
    /// episode.
    fn begin_again(&mut self, environment: usize);

    /// Updates the policies once with the rollout data of iteration `iteration` and their rewards.
    ///
    /// # Errors
    /// If the batch does not match the problem; the error names the first invalid array.
    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Relabelled<'_>,
        iteration: u64,
    ) -> Result<Report, MarlError>;

    /// The current policies.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn snapshot(&self) -> Result<PolicySnapshot, MarlError>;

    /// The arrays of its state under `weights/`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn weights(&mut self) -> Result<NamedArrays, MarlError> {
        self.arrays_under("weights/")
    }
}
