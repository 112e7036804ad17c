//! Settings of the densities and of the reward that they give.

use serde::{Deserialize, Serialize};

use super::{count, not_negative, positive, refuse, within};
use crate::data::batch::AgentShape;
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
    /// Weight of the moments that were known before, in `[0, 1)`, if `fit` is `ema`.
    pub ema_memory: f64,
    /// Which numbers are scored.
    pub space: Space,
    /// Those of which side of a step.
    pub obs: Scored,
    /// How features are joined.
    pub reduce: Reduce,
    /// The additive constant of the bonus.
    pub constant: Constant,
    /// Largest magnitude of what alpha multiplies, nats; 0 for none.
    pub clip: f64,
    /// Smallest deviation that a density assumes, in units of the feature.
    pub feature_sigma_floor: f64,
    /// Features with a smaller deviation on `D_k` are left out, in units of the feature.
    pub mask_below: f64,
    /// What `density = vae` alone is told.
    pub vae: VaeConfig,
}

/// A variational autoencoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VaeConfig {
    /// Units of its hidden layers.
    pub hidden: usize,
    /// Latent dimensions.
    pub latent: usize,
    /// Passes over `D_k`.
    pub epochs: usize,
    /// Parts of one pass, each an optimiser step.
    pub minibatches: usize,
    /// Adam's step size.
    pub learning_rate: f64,
}

/// The classes of densities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityKind {
    /// An independent Gaussian per feature, as in the paper.
    DiagonalGaussian,
    /// Independent frequencies per feature, for features that take few values.
    Categorical,
    /// A variational autoencoder, trained on from iteration to iteration.
    Vae,
}

/// Which experience the density that scores `D_k` was fitted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// On `D_k` itself, as the paper's text has it.
    Current,
    /// On `D_(k-1)`: the density that was known when `D_k` was collected. Iteration 0 has no bonus.
    Previous,
    /// On all experience, the older the lighter.
    Ema,
}

/// Which numbers surprise scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Space {
    /// Observations as the policy sees them.
    PolicyObs,
    /// The same features before any scaling.
    Raw,
    /// What is near the agent, unscaled, whatever the policy sees.
    Local,
}

/// Which side of a step surprise scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scored {
    /// `o_t`, as in Eq. 9: a terminal observation is never scored.
    Current,
    /// `o_(t+1)`, on which the action has an influence; at an episode's end the terminal one.
    Next,
}

/// How the features' log-densities are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduce {
    /// Their sum, as in Eq. 4.
    Sum,
    /// The sum divided by the number of features that count.
    Mean,
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
        positive("surprise.feature_sigma_floor", self.feature_sigma_floor)?;
        not_negative("surprise.mask_below", self.mask_below)?;
        not_negative("surprise.clip", self.clip)?;
        let memory = "0 <= ema_memory < 1";
        within("surprise.ema_memory", self.ema_memory, 0.0..1.0, memory)?;
        self.vae.validate()?;
        self.validate_density()
    }

    /// Refuses a space in which the environment does not say what an agent's features are.
    pub(super) fn suits_agents(&self, agents: &[AgentShape]) -> Result<(), MarlError> {
        let range = "policy_obs: the global state does not hold what these agents see";
        let bare =
            |places: fn(&AgentShape) -> &[usize]| agents.iter().any(|a| places(a).is_empty());
        match self.space {
            Space::Raw if bare(|a| &a.seen) => Err(refuse("surprise.space", "raw", range)),
            Space::Local if bare(|a| &a.near) => Err(refuse("surprise.space", "local", range)),
            Space::PolicyObs | Space::Raw | Space::Local => Ok(()),
        }
    }

    /// Refuses what the class of densities gives no meaning to.
    fn validate_density(&self) -> Result<(), MarlError> {
        let gaussian = self.density == DensityKind::DiagonalGaussian;
        if self.fit == Fit::Ema && !gaussian {
            let range = "current or previous: only diagonal_gaussian has moments to average";
            return Err(refuse("surprise.fit", "ema", range));
        }
        if self.constant == Constant::Paper && self.density == DensityKind::Categorical {
            let range =
                "density or centered: categorical has no Gaussian whose constant could be left out";
            return Err(refuse("surprise.constant", "paper", range));
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
