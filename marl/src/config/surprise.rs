//! Settings of the densities and of the surprise reward.

use serde::{Deserialize, Serialize};

use super::{count, not_negative, out_of_range, positive, within};
use crate::data::batch::AgentShape;
use crate::error::MarlError;

/// Surprise minimisation (Eq. 2-4, 9).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurpriseConfig {
    /// Weight of the log-density in the reward.
    pub alpha: f64,
    /// Class of densities.
    pub density: DensityKind,
    /// Rollout data on which the density that scores `D_k` is fitted.
    pub fit: Fit,
    /// Weight of the previous moments with `fit = "ema"`, in `[0, 1)`.
    pub ema_memory: f64,
    /// Scored features.
    pub space: Space,
    /// Whether the observation before or after a step is scored.
    pub obs: Scored,
    /// Combination of the features' log-densities.
    pub reduce: Reduce,
    /// Additive constant of the bonus.
    pub constant: Constant,
    /// Largest magnitude of the term that alpha multiplies, nats. 0: no clipping.
    pub clip: f64,
    /// Lower bound of a density's standard deviation, in units of the feature.
    pub feature_sigma_floor: f64,
    /// Features with a smaller standard deviation on `D_k` are left out, in units of the feature.
    pub mask_below: f64,
    /// Settings of `density = vae` only.
    pub vae: VaeConfig,
}

/// A variational autoencoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VaeConfig {
    /// Units of the hidden layers.
    pub hidden: usize,
    /// Latent dimensions.
    pub latent: usize,
    /// Epochs over `D_k`.
    pub epochs: usize,
    /// Minibatches per epoch, each an optimiser step.
    pub minibatches: usize,
    /// Adam's learning rate.
    pub learning_rate: f64,
}

/// The classes of densities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityKind {
    /// An independent Gaussian per feature, as in the paper.
    DiagonalGaussian,
    /// An independent categorical distribution per feature, for features with few distinct values.
    Categorical,
    /// A variational autoencoder. Its training continues from iteration to iteration.
    Vae,
}

/// Rollout data on which the density that scores `D_k` is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// `D_k` itself, as in the paper's text.
    Current,
    /// `D_(k-1)`, known when `D_k` was collected. Iteration 0 has no bonus.
    Previous,
    /// All iterations, with weights that decrease with age.
    Ema,
}

/// Features that surprise scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Space {
    /// Scaled observations, the policy's input.
    PolicyObs,
    /// The same features without scaling.
    Raw,
    /// Features near the agent without scaling, independent of the policy's input.
    Local,
}

/// Whether the observation before or after a step is scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scored {
    /// `o_t`, as in Eq. 9. Terminal observations are not scored.
    Current,
    /// `o_(t+1)`, which the action influences; at an episode's end the terminal observation.
    Next,
}

/// Combination of the features' log-densities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduce {
    /// Their sum, as in Eq. 4.
    Sum,
    /// The sum divided by the number of active features.
    Mean,
}

/// Additive constant of the surprise bonus. It matters only where episodes can end early: there it rewards or penalises
/// staying alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Constant {
    /// Eq. 4: the log-density without `-1/2 log 2 pi` per feature.
    Paper,
    /// Eq. 3: the log-density itself.
    Density,
    /// The log-density minus its mean at the fit: no reward for staying alive.
    Centered,
}

impl SurpriseConfig {
    pub(super) fn validate(&self) -> Result<(), MarlError> {
        not_negative("surprise.alpha", self.alpha)?;
        positive("surprise.feature_sigma_floor", self.feature_sigma_floor)?;
        not_negative("surprise.mask_below", self.mask_below)?;
        not_negative("surprise.clip", self.clip)?;
        let memory = "0 <= ema_memory < 1";
        within("surprise.ema_memory", self.ema_memory, 0.0..1.0, memory)?;
        self.vae.validate()?;
        self.validate_density()
    }

    /// Rejects a space whose features the environment does not list.
    pub(super) fn suits_agents(&self, agents: &[AgentShape]) -> Result<(), MarlError> {
        let range = "policy_obs: the global state does not contain these agents' observations";
        let missing =
            |places: fn(&AgentShape) -> &[usize]| agents.iter().any(|a| places(a).is_empty());
        match self.space {
            Space::Raw if missing(|a| &a.seen) => Err(out_of_range("surprise.space", "raw", range)),
            Space::Local if missing(|a| &a.near) => {
                Err(out_of_range("surprise.space", "local", range))
            }
            Space::PolicyObs | Space::Raw | Space::Local => Ok(()),
        }
    }

    /// Rejects settings that the class of densities does not support.
    fn validate_density(&self) -> Result<(), MarlError> {
        let gaussian = self.density == DensityKind::DiagonalGaussian;
        if self.fit == Fit::Ema && !gaussian {
            let range = "current or previous: only diagonal_gaussian has moments to average";
            return Err(out_of_range("surprise.fit", "ema", range));
        }
        if self.constant == Constant::Paper && self.density == DensityKind::Categorical {
            let range = "density or centered: categorical has no Gaussian constant to omit";
            return Err(out_of_range("surprise.constant", "paper", range));
        }
        Ok(())
    }
}

impl VaeConfig {
    fn validate(&self) -> Result<(), MarlError> {
        count("surprise.vae.hidden", self.hidden)?;
        count("surprise.vae.latent", self.latent)?;
        count("surprise.vae.epochs", self.epochs)?;
        count("surprise.vae.minibatches", self.minibatches)?;
        positive("surprise.vae.learning_rate", self.learning_rate)
    }
}
