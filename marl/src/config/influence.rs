//! Settings of the influence term and its posteriors.

use serde::{Deserialize, Serialize};

use super::{count, not_negative, positive, refuse};
use crate::error::MarlError;

/// Influence maximisation (Eq. 5-10).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InfluenceConfig {
    /// Weight of the influence term (Eq. 5, 10). At 0 no posterior is built.
    pub lambda: f64,
    /// How mutual information is estimated.
    pub estimator: Estimator,
    /// Which divergence stands in the regulariser.
    pub divergence: Divergence,
    /// How the posterior is trained.
    pub q_training: QTraining,
    /// Cap of the divergence, nats per action dimension.
    pub kappa: f64,
    /// Units of the encoder of the other agents' actions.
    pub encoder: usize,
    /// Units of the layer that joins it with the policy's features.
    pub hidden: usize,
    /// Passes over `D_k`.
    pub epochs: usize,
    /// Adam's step size.
    pub learning_rate: f64,
    /// Parts of one pass, each an optimiser step.
    pub minibatches: usize,
    /// Smallest deviation of a posterior, in units of the action.
    pub posterior_sigma_floor: f64,
    /// Environments `e` with `e mod n = n - 1` train no posterior; they measure the estimate.
    pub holdout_every: usize,
    /// Steps, 0 or 1, by which the others' actions that q is told are older than the own one.
    pub lag: usize,
    /// What stands for the state in the tables of `estimator = count`.
    pub counted_state: CountedState,
}

/// How mutual information is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// Eq. 8: the divergence of a learnt posterior from the policy.
    VariationalKl,
    /// Barber and Agakov's lower bound, `E_p[log q + H[p]] = -KL[p || q]` for each row.
    BarberAgakov,
    /// Eq. 7: from how often each joint action occurs. It needs discrete actions.
    Count,
}

/// What stands for the state where joint actions are counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CountedState {
    /// What the agent observes.
    Observation,
    /// The global state.
    Global,
}

/// Which divergence stands in the regulariser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Divergence {
    /// `KL[q || p]`, as in Eq. 8 and 10.
    KlQp,
    /// `KL[p || q]`: it grows where the policy acts and the posterior does not expect it.
    KlPq,
    /// Cauchy and Schwarz's: symmetric, and it grows only with the logarithm as sigma shrinks.
    CauchySchwarz,
}

/// How the posterior is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QTraining {
    /// By maximum likelihood of the actions taken, before the policies move.
    Mle,
    /// By Eq. 10 itself: a second head on the policy's trunk (Fig. 1), and one optimiser for all three.
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
        positive("influence.posterior_sigma_floor", self.posterior_sigma_floor)?;
        if self.holdout_every < 2 {
            let range = "at least 2: with 1 no environment would be left to train on";
            return Err(refuse("influence.holdout_every", self.holdout_every, range));
        }
        if self.lag > 1 {
            let range = "0 (the same step's actions) or 1 (the step before's)";
            return Err(refuse("influence.lag", self.lag, range));
        }
        self.validate_estimator()
    }

    /// Refuses what is not defined for choices.
    pub(crate) fn check_for_choices(&self) -> Result<(), MarlError> {
        match self.q_training {
            QTraining::Shared if self.lambda > 0.0 => {
                Err(refuse("influence.q_training", "shared", "mle for a task of choices"))
            }
            QTraining::Mle | QTraining::Shared => Ok(()),
        }
    }

    /// Refuses what is not defined for continuous actions.
    pub(crate) fn check_for_numbers(&self) -> Result<(), MarlError> {
        let range = "variational_kl or barber_agakov for continuous actions: counts need choices";
        match self.estimator {
            Estimator::Count => Err(refuse("influence.estimator", "count", range)),
            Estimator::VariationalKl | Estimator::BarberAgakov => Ok(()),
        }
    }

    fn validate_estimator(&self) -> Result<(), MarlError> {
        let bound = "kl_pq with estimator = barber_agakov, whose bound is -KL[p || q]";
        let counted = "mle with estimator = count: a table of counts has no parameters to train";
        if (self.estimator, self.q_training) == (Estimator::Count, QTraining::Shared) {
            return Err(refuse("influence.q_training", "shared", counted));
        }
        match (self.estimator, self.divergence) {
            (Estimator::BarberAgakov, Divergence::KlQp) => {
                Err(refuse("influence.divergence", "kl_qp", bound))
            }
            (Estimator::BarberAgakov, Divergence::CauchySchwarz) => {
                Err(refuse("influence.divergence", "cauchy_schwarz", bound))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::data::batch::ActionKind;
    use crate::probe;

    /// Why the settings are refused for actions of this kind.
    fn refusal(kind: ActionKind, change: impl Fn(&mut InfluenceConfig)) -> Option<String> {
        let mut config: Config = probe::config();
        change(&mut config.influence);
        let mut problem = probe::problem();
        problem.agents.iter_mut().for_each(|agent| agent.kind = kind);
        let found = config.validate().and_then(|()| config.suits_agents(&problem));
        found.err().map(|error| error.to_string())
    }

    #[test]
    fn what_is_not_defined_for_a_kind_of_action_is_refused_in_one_line() {
        let choices = ActionKind::Discrete { choices: 3 };
        let count = |config: &mut InfluenceConfig| config.estimator = Estimator::Count;
        let shared = |config: &mut InfluenceConfig| config.q_training = QTraining::Shared;
        assert_eq!(refusal(choices, count), None);
        assert_eq!(refusal(ActionKind::Continuous, shared), None);
        for (kind, message) in [
            (
                refusal(ActionKind::Continuous, count),
                "influence.estimator = count is out of range: variational_kl or barber_agakov for \
                 continuous actions: counts need choices",
            ),
            (
                refusal(choices, shared),
                "influence.q_training = shared is out of range: mle for a task of choices",
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
                "influence.lag = 2 is out of range: 0 (the same step's actions) or 1 (the step \
                 before's)",
            ),
        ] {
            assert_eq!(kind.as_deref(), Some(message));
        }
    }
}
