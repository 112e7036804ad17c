//! Settings of the surprise reward.

use policy::setting::{SettingError, between};
use serde::{Deserialize, Serialize};

use super::MOST_WEIGHT;

/// Surprise minimisation (Eq. 2-4, 9).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurpriseConfig {
    /// Weight of the log-density in the reward.
    pub alpha: f64,
    /// Class of densities.
    pub density: DensityKind,
}

/// The classes of densities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityKind {
    /// An independent Gaussian per feature, as in the paper.
    DiagonalGaussian,
    /// An independent categorical distribution per feature, for features with few distinct values.
    Categorical,
    /// An independent Gaussian per output of a fixed random network of the observation, as in E2M.
    RandomEncoder,
    /// A variational autoencoder. Its training continues from iteration to iteration.
    Vae,
}

impl SurpriseConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        between("surprise.alpha", self.alpha, 0.0, MOST_WEIGHT)
    }
}
