//! Settings of the influence term and its posteriors.

use serde::{Deserialize, Serialize};

use super::{count, not_negative, out_of_range, positive, within};
use crate::error::MarlError;

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
    pub(super) fn validate(&self) -> Result<(), MarlError> {
        not_negative("influence.lambda", self.lambda)?;
        positive("influence.kappa", self.kappa)?;
        count("influence.encoder", self.encoder)?;
        count("influence.hidden", self.hidden)?;
        count("influence.epochs", self.epochs)?;
        positive("influence.learning_rate", self.learning_rate)?;
        count("influence.minibatches", self.minibatches)?;
        let (floor, range) = (self.posterior_sigma_floor, "above 0, at most 0.3");
        within("influence.posterior_sigma_floor", floor, f64::MIN_POSITIVE..=0.3, range)?;
        if self.holdout_every < 2 {
            let range = "at least 2: with 1 no environment would be left to train on";
            return Err(out_of_range("influence.holdout_every", self.holdout_every, range));
        }
        if self.lag > 1 {
            let range = "0 (the same step's actions) or 1 (the previous step's)";
            return Err(out_of_range("influence.lag", self.lag, range));
        }
        if (self.estimator, self.q_training) == (Estimator::Count, QTraining::Shared) {
            let range = "mle with estimator = count: a table of counts has no parameters to train";
            return Err(out_of_range("influence.q_training", "shared", range));
        }
        Ok(())
    }

    /// Rejects settings that are not defined for discrete actions.
    pub(crate) fn check_for_choices(&self) -> Result<(), MarlError> {
        match self.q_training {
            QTraining::Shared if self.lambda > 0.0 => Err(out_of_range(
                "influence.q_training",
                "shared",
                "mle for a task with discrete actions",
            )),
            QTraining::Mle | QTraining::Shared => Ok(()),
        }
    }

    /// Rejects settings that are not defined for continuous actions.
    pub(crate) fn check_for_numbers(&self) -> Result<(), MarlError> {
        let range = "variational_kl for continuous actions: counts need discrete actions";
        match self.estimator {
            Estimator::Count => Err(out_of_range("influence.estimator", "count", range)),
            Estimator::VariationalKl => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::data::batch::ActionKind;
    use crate::sample;

    /// Error message for actions of this kind.
    fn refusal(kind: ActionKind, change: impl Fn(&mut InfluenceConfig)) -> Option<String> {
        let mut config: Config = sample::config();
        change(&mut config.influence);
        let mut problem = sample::problem();
        problem.agents.iter_mut().for_each(|agent| agent.kind = kind);
        let found = config.validate().and_then(|()| config.suits_agents(&problem));
        found.err().map(|error| error.to_string())
    }

    #[test]
    fn settings_undefined_for_a_kind_of_action_are_rejected() {
        let choices = ActionKind::Discrete { choices: 3 };
        let count = |config: &mut InfluenceConfig| config.estimator = Estimator::Count;
        let shared = |config: &mut InfluenceConfig| config.q_training = QTraining::Shared;
        assert_eq!(refusal(choices, count), None);
        assert_eq!(refusal(ActionKind::Continuous, shared), None);
        for (kind, message) in [
            (
                refusal(ActionKind::Continuous, count),
                "influence.estimator = count is out of range: variational_kl for continuous actions: \
                 counts need discrete actions",
            ),
            (
                refusal(choices, shared),
                "influence.q_training = shared is out of range: mle for a task with discrete actions",
            ),
            (
                refusal(choices, |config| {
                    count(config);
                    shared(config);
                }),
                "influence.q_training = shared is out of range: mle with estimator = count: a table of \
                 counts has no parameters to train",
            ),
            (
                refusal(choices, |config| config.lag = 2),
                "influence.lag = 2 is out of range: 0 (the same step's actions) or 1 (the previous \
                 step's)",
            ),
        ] {
            assert_eq!(kind.as_deref(), Some(message));
        }
    }
}
