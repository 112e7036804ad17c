//! Settings of MADDPG only: its replay, targets and exploration.

use serde::{Deserialize, Serialize};

use super::{Config, CriticCore, StateNorm, count, out_of_range, positive, within};
use crate::error::MarlError;

/// MADDPG's exploration, replay and targets. Learning rates, discount and critic sizes are in the sections `update` and
/// `critic`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaddpgConfig {
    /// Capacity in transitions; the oldest are overwritten first. A transition takes four bytes per number of the
    /// state, all observations and all actions, plus five.
    pub replay: usize,
    /// Transitions per optimiser step.
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
    pub(super) fn validate(&self) -> Result<(), MarlError> {
        within("maddpg.replay", self.replay as f64, 1.0..=1e6, "1 to 1000000")?;
        count("maddpg.batch", self.batch)?;
        count("maddpg.n_step", self.n_step)?;
        let ratio = "0 < updates_per_step <= 10";
        let updates = f64::MIN_POSITIVE..=10.0;
        within("maddpg.updates_per_step", self.updates_per_step, updates, ratio)?;
        positive("maddpg.noise", self.noise)?;
        within("maddpg.polyak", self.polyak, f64::MIN_POSITIVE..=1.0, "0 < polyak <= 1")
    }
}

impl Config {
    /// Rejects settings that MADDPG does not support.
    pub(super) fn check_for_maddpg(&self) -> Result<(), MarlError> {
        if self.critic.core == CriticCore::Gru {
            let range =
                "mlp with update.rule = maddpg: the replay holds single steps, no recurrent states";
            return Err(out_of_range("critic.core", "gru", range));
        }
        let stale = "0 with update.rule = maddpg: the density is refitted in every iteration, \
                     so rewards in the replay would be stale";
        within("surprise.alpha", self.surprise.alpha, 0.0..=0.0, stale)?;
        if self.critic.state_norm == StateNorm::Running {
            let range = "none or feature_z with update.rule = maddpg: the scale of states in the replay would be stale";
            return Err(out_of_range("critic.state_norm", self.critic.state_norm.name(), range));
        }
        let pointless = "0 with update.rule = maddpg: a deterministic policy has no density to \
                         regularise";
        within("influence.lambda", self.influence.lambda, 0.0..=0.0, pointless)
    }
}
