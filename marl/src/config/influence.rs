//! Settings of the influence term and its posteriors.

use policy::setting::{SettingError, between, learning_rate, positive, within};
use serde::{Deserialize, Serialize};

use super::{MOST_PASSES, MOST_WEIGHT, WIDEST};

/// Influence maximisation (Eq. 5-10).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InfluenceConfig {
    /// Weight of the influence term (Eq. 5, 10). 0: no posterior is built.
    pub lambda: f64,
    /// Estimator of mutual information.
    pub estimator: Estimator,
    /// Training of the posterior.
    pub q_training: QTraining,
    /// Cap of the divergence, nats per action dimension.
    pub kappa: f64,
    /// Units of the encoder of the other agents' actions.
    pub encoder: usize,
    /// Units of the layer after the encoder and the policy's features.
    pub hidden: usize,
    /// Maximum number of epochs over `D_k`.
    pub epochs: usize,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Minibatches per epoch, each an optimiser step.
    pub minibatches: usize,
    /// Smallest standard deviation of a posterior, in units of half an action's range.
    pub posterior_sigma_floor: f64,
    /// Environments `e` with `e mod n = n - 1` are held out from training; the estimate is measured on them.
    pub holdout_every: usize,
    /// Steps, 0 or 1, between the others' actions that q receives and the agent's own action.
    pub lag: usize,
}

/// Estimator of mutual information.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// Eq. 8: divergence of a learnt posterior from the policy.
    VariationalKl,
    /// Eq. 7: frequencies of joint actions. Needs discrete actions.
    Count,
    /// Eq. 5 in closed form, by the loadings of noise that agents share.
    Exact,
}

/// Training of the posterior.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QTraining {
    /// Maximum likelihood of the actions taken, before the policies are updated.
    Mle,
    /// Eq. 10: a second head on the policy's trunk (Fig. 1), and one optimiser for both heads and the trunk.
    Shared,
}

impl InfluenceConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        between("influence.lambda", self.lambda, 0.0, MOST_WEIGHT)?;
        positive("influence.kappa", self.kappa)?;
        between("influence.encoder", self.encoder, 1, WIDEST)?;
        between("influence.hidden", self.hidden, 1, WIDEST)?;
        between("influence.epochs", self.epochs, 1, MOST_PASSES)?;
        learning_rate("influence.learning_rate", self.learning_rate)?;
        between("influence.minibatches", self.minibatches, 1, MOST_PASSES)?;
        positive("influence.posterior_sigma_floor", self.posterior_sigma_floor)?;
        let some = "at least 2: with 1 no environment would be left to train on";
        within("influence.holdout_every", self.holdout_every, 2.., some)?;
        let lags = "0 (the same step's actions) or 1 (the previous step's)";
        within("influence.lag", self.lag, 0..=1, lags)
    }
}
