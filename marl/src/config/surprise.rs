//! Settings of the densities and of the reward that they give.

use serde::{Deserialize, Serialize};

use super::{not_negative, positive};
use crate::error::MarlError;

/// Surprise minimisation (Eq. 2-4, 9).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurpriseConfig {
    /// Weight of the log-density in the reward.
    pub alpha: f64,
    /// The class of densities.
    pub density: DensityKind,
    /// Which experience the density that scores `D_k` was fitted on.
    pub fit: Fit,
    /// What is scored.
    pub space: Space,
    /// How features are joined.
    pub reduce: Reduce,
    /// The additive constant of the bonus.
    pub constant: Constant,
    /// Smallest deviation that a density assumes, in units of the feature.
    pub sigma_floor: f64,
    /// Features with a smaller deviation on `D_k` are left out, in units of the feature.
    pub mask_below: f64,
}

/// The classes of densities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityKind {
    /// An independent Gaussian per feature, as in the paper.
    DiagonalGaussian,
}

/// Which experience the density that scores `D_k` was fitted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// On `D_k` itself, as the paper's text has it.
    Current,
}

/// What surprise scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Space {
    /// Observations as the policy sees them.
    PolicyObs,
}

/// How the features' log-densities are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduce {
    /// Their sum, as in Eq. 4.
    Sum,
}

/// The additive constant of the surprise bonus. Inside an episode it changes nothing; where
/// episodes can end early it pays or charges for staying alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Constant {
    /// Eq. 4: the log-density without `-1/2 log 2 pi` per feature.
    Paper,
    /// Eq. 3: the log-density itself.
    Density,
    /// The log-density minus its mean at the fit: no pay for staying alive.
    Centered,
}

impl SurpriseConfig {
    pub(super) fn validate(&self) -> Result<(), MarlError> {
        not_negative("surprise.alpha", self.alpha)?;
        positive("surprise.sigma_floor", self.sigma_floor)?;
        not_negative("surprise.mask_below", self.mask_below)
    }
}
