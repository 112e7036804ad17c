//! Settings of MADDPG alone: its replay, its targets, its exploration.

use serde::{Deserialize, Serialize};

use super::{count, positive, within};
use crate::error::MarlError;

/// How MADDPG explores, remembers and learns. Step sizes, discount and the critics' sizes are those
/// of the sections `update` and `critic`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaddpgConfig {
    /// Transitions that are remembered; the oldest are forgotten first. Each costs four bytes per
    /// number of the state, all observations and all actions, and five more.
    pub replay: usize,
    /// Transitions in one optimiser step.
    pub batch: usize,
    /// Steps of reward before a target bootstraps.
    pub n_step: usize,
    /// Environment steps in which all actions are uniform and nothing is learnt.
    pub warm_up: u64,
    /// Optimiser steps per environment step after the warm-up.
    pub updates_per_step: f64,
    /// Deviation of the exploration noise, in halves of the action's range.
    pub noise: f64,
    /// Share of the way that a target network goes towards its original at each optimiser step.
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
