//! Settings of HASAC only: its replay, normalisation and temperature.

use policy::setting::{SettingError, between, count, within};
use serde::{Deserialize, Serialize};

use super::{MOST_WEIGHT, UPDATES_PER_STEP};

/// HASAC's replay, batch norm and temperature. Learning rates, discount and sizes are in the sections `update`, `critic`
/// and `policy`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HasacConfig {
    /// Capacity in transitions; the oldest are overwritten first. A transition takes four bytes per number of the
    /// state, all observations and all actions, plus five.
    pub replay: usize,
    /// Transitions per optimiser step; a step takes memory in proportion to them.
    pub batch: usize,
    /// Steps of reward before a target bootstraps.
    pub n_step: usize,
    /// Environment steps with uniform actions and without learning.
    pub warm_up: u64,
    /// Optimiser steps of the critics per environment step after the warm-up.
    pub updates_per_step: f64,
    /// Optimiser steps of the critics per optimiser step of the policies.
    pub policy_every: u64,
    /// Fraction by which the running statistics of a batch norm approach those of a batch.
    pub norm_momentum: f64,
    /// Initial temperature of every policy, the weight of its entropy.
    pub initial_temperature: f64,
    /// Decay of Adam's first moment.
    pub first_moment: f64,
}

impl HasacConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        between("hasac.replay", self.replay, 1, 1_000_000)?;
        between("hasac.batch", self.batch, 2, 65_536)?;
        count("hasac.n_step", self.n_step)?;
        let (fewest, most) = UPDATES_PER_STEP;
        between("hasac.updates_per_step", self.updates_per_step, fewest, most)?;
        within("hasac.policy_every", self.policy_every, 1.., "at least 1")?;
        let momentum = f64::MIN_POSITIVE..=1.0;
        within("hasac.norm_momentum", self.norm_momentum, momentum, "0 < norm_momentum <= 1")?;
        between("hasac.initial_temperature", self.initial_temperature, 1e-6, MOST_WEIGHT)?;
        let range = "0 <= first_moment < 1";
        within("hasac.first_moment", self.first_moment, 0.0..1.0, range)
    }
}
