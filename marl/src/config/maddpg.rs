//! Settings of MADDPG only: its replay, targets and exploration.

use policy::setting::{SettingError, between, count, within};
use serde::{Deserialize, Serialize};

use super::UPDATES_PER_STEP;

/// MADDPG's exploration, replay and targets. Learning rates, discount and critic sizes are in the sections `update` and
/// `critic`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaddpgConfig {
    /// Capacity in transitions; the oldest are overwritten first. A transition takes four bytes per number of the
    /// state, all observations and all actions, plus five.
    pub replay: usize,
    /// Transitions per optimiser step; a step takes memory in proportion to them.
    pub batch: usize,
    /// Steps of reward before a target bootstraps.
    pub n_step: usize,
    /// Environment steps with uniform actions and without learning.
    pub warm_up: u64,
    /// Optimiser steps per environment step after the warm-up.
    pub updates_per_step: f64,
    /// Standard deviation of the exploration noise, in halves of the action range.
    pub noise: f64,
    /// Polyak factor: fraction by which a target network approaches its source per optimiser step.
    pub polyak: f64,
}

impl MaddpgConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        between("maddpg.replay", self.replay, 1, 1_000_000)?;
        between("maddpg.batch", self.batch, 1, 65_536)?;
        count("maddpg.n_step", self.n_step)?;
        let (fewest, most) = UPDATES_PER_STEP;
        between("maddpg.updates_per_step", self.updates_per_step, fewest, most)?;
        // Actors have the noise in single precision.
        let noises = f64::from(f32::MIN_POSITIVE)..=10.0;
        within("maddpg.noise", self.noise, noises, "above 0, at most 10")?;
        within("maddpg.polyak", self.polyak, f64::MIN_POSITIVE..=1.0, "0 < polyak <= 1")
    }
}
