//! Settings of the update, the critic, surprise and influence. No defaults live here: the binary's
//! configuration files hold them.

mod maddpg;

use policy::{CoreKind, PolicyConfig};
use serde::{Deserialize, Serialize};

pub use self::maddpg::MaddpgConfig;
use crate::batch::Problem;
use crate::error::MarlError;

/// Everything that the learning rule is told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The policy update.
    pub update: UpdateConfig,
    /// The value function.
    pub critic: CriticConfig,
    /// Surprise minimisation (Eq. 2-4, 9).
    pub surprise: SurpriseConfig,
    /// Influence maximisation (Eq. 5-10).
    pub influence: InfluenceConfig,
    /// What MADDPG alone is told.
    pub maddpg: MaddpgConfig,
}

/// How policies are updated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UpdateConfig {
    /// The learning rule.
    pub rule: Rule,
    /// Whether agents have networks of their own.
    pub parameters: Sharing,
    /// Discount per step, in `[0, 1)`.
    pub gamma: f64,
    /// Decay of the advantage's trace, in `[0, 1]`.
    pub gae_lambda: f64,
    /// Adam's step size.
    pub learning_rate: f64,
    /// Adam's epsilon; also the critic's and the posteriors'.
    pub adam_epsilon: f64,
    /// Half width of the ratio's trust region.
    pub clip: f64,
    /// Passes over `D_k` per agent.
    pub epochs: usize,
    /// Parts of one pass, each an optimiser step.
    pub minibatches: usize,
    /// Weight of the entropy bonus.
    pub entropy: f64,
    /// Global norm to which gradients are clipped.
    pub max_gradient_norm: f64,
    /// Parts of a minibatch computed side by side and summed in order. It changes the last bits of
    /// a result, so it is never taken from the machine.
    pub shards: usize,
}

/// The learning rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Heterogeneous-agent PPO: one agent after the other, in random order.
    Happo,
    /// Multi-agent PPO: all agents at once.
    Mappo,
    /// Multi-agent deterministic policy gradients out of a replay.
    Maddpg,
}

/// Whether agents have networks of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sharing {
    /// Each agent has its own.
    Separate,
    /// One network acts for all of them, which must then be of equal sizes.
    Shared,
}

/// The value function and how it is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CriticConfig {
    /// Whose returns are valued.
    pub mode: CriticMode,
    /// Hidden layers.
    pub layers: usize,
    /// Units per layer.
    pub width: usize,
    /// Adam's step size.
    pub learning_rate: f64,
    /// Passes over `D_k`.
    pub epochs: usize,
    /// Parts of one pass, each an optimiser step.
    pub minibatches: usize,
    /// Farthest a value may move from its old one before the loss ignores it, normalised units.
    pub clip: f64,
    /// Error at which the loss turns from quadratic to linear, normalised units.
    pub huber_delta: f64,
    /// Memory of the returns' running mean and deviation, per iteration, in `[0, 1)`.
    pub normalizer_beta: f64,
    /// Global norm to which gradients are clipped.
    pub max_gradient_norm: f64,
}

/// Whose returns are valued.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CriticMode {
    /// One network with one value per agent, each normalised by itself.
    PerAgent,
}

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
    pub sigma_floor: f64,
    /// Environments `e` with `e mod n = n - 1` train no posterior; they measure the estimate.
    pub holdout_every: usize,
}

/// How mutual information is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// Eq. 8: the divergence of a learnt posterior from the policy.
    VariationalKl,
}

/// Which divergence stands in the regulariser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Divergence {
    /// `KL[q || p]`, as in Eq. 8 and 10.
    KlQp,
}

/// How the posterior is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QTraining {
    /// By maximum likelihood of the actions taken, before the policies move.
    Mle,
}

impl Config {
    /// Refuses values outside their ranges.
    ///
    /// # Errors
    /// Names the first key that is wrong and its range.
    pub fn validate(&self) -> Result<(), MarlError> {
        self.update.validate()?;
        self.critic.validate()?;
        self.surprise.validate()?;
        self.influence.validate()?;
        self.maddpg.validate()?;
        if self.update.rule != Rule::Maddpg {
            return Ok(());
        }
        let stale = "0 with update.rule = maddpg: rewards of a density that is fitted again in \
                     every iteration would be stale in the replay";
        within("surprise.alpha", self.surprise.alpha, 0.0..=0.0, stale)?;
        let pointless = "0 with update.rule = maddpg: a deterministic policy has no density to \
                         regularise";
        within("influence.lambda", self.influence.lambda, 0.0..=0.0, pointless)
    }

    /// Refuses actor networks that the rule cannot train.
    ///
    /// # Errors
    /// Names the key that does not fit.
    pub fn suits(&self, policy: &PolicyConfig) -> Result<(), MarlError> {
        if self.update.rule == Rule::Maddpg && policy.core == CoreKind::Gru {
            let range = "mlp with update.rule = maddpg: the replay holds single steps, no \
                         recurrent states";
            return Err(refuse("policy.core", "gru", range));
        }
        Ok(())
    }

    /// Refuses agents that cannot share their parameters although they should.
    ///
    /// # Errors
    /// Names the first agent whose sizes differ from the first one's.
    pub fn suits_agents(&self, problem: &Problem) -> Result<(), MarlError> {
        let sizes = |index: usize| {
            let agent = &problem.agents[index];
            (agent.observation, agent.action)
        };
        let odd = (0..problem.agents.len()).find(|&index| sizes(index) != sizes(0));
        match (self.update.parameters, odd) {
            (Sharing::Shared, Some(other)) => {
                let (first, second) = (sizes(0), sizes(other));
                Err(MarlError::Unequal { first, other, second })
            }
            _ => Ok(()),
        }
    }
}

impl UpdateConfig {
    fn validate(&self) -> Result<(), MarlError> {
        if self.rule != Rule::Mappo && self.parameters == Sharing::Shared {
            let range = "separate; only update.rule = mappo can share them";
            return Err(refuse("update.parameters", "shared", range));
        }
        within("update.gamma", self.gamma, 0.0..1.0, "0 <= gamma < 1")?;
        within("update.gae_lambda", self.gae_lambda, 0.0..=1.0, "0 <= gae_lambda <= 1")?;
        positive("update.learning_rate", self.learning_rate)?;
        positive("update.adam_epsilon", self.adam_epsilon)?;
        within("update.clip", self.clip, f64::MIN_POSITIVE..1.0, "0 < clip < 1")?;
        count("update.epochs", self.epochs)?;
        count("update.minibatches", self.minibatches)?;
        not_negative("update.entropy", self.entropy)?;
        positive("update.max_gradient_norm", self.max_gradient_norm)?;
        count("update.shards", self.shards)
    }
}

impl CriticConfig {
    fn validate(&self) -> Result<(), MarlError> {
        count("critic.layers", self.layers)?;
        count("critic.width", self.width)?;
        positive("critic.learning_rate", self.learning_rate)?;
        count("critic.epochs", self.epochs)?;
        count("critic.minibatches", self.minibatches)?;
        positive("critic.clip", self.clip)?;
        positive("critic.huber_delta", self.huber_delta)?;
        within("critic.normalizer_beta", self.normalizer_beta, 0.0..1.0, "0 <= beta < 1")?;
        positive("critic.max_gradient_norm", self.max_gradient_norm)
    }
}

impl SurpriseConfig {
    fn validate(&self) -> Result<(), MarlError> {
        not_negative("surprise.alpha", self.alpha)?;
        positive("surprise.sigma_floor", self.sigma_floor)?;
        not_negative("surprise.mask_below", self.mask_below)
    }
}

impl InfluenceConfig {
    fn validate(&self) -> Result<(), MarlError> {
        not_negative("influence.lambda", self.lambda)?;
        positive("influence.kappa", self.kappa)?;
        count("influence.encoder", self.encoder)?;
        count("influence.hidden", self.hidden)?;
        count("influence.epochs", self.epochs)?;
        positive("influence.learning_rate", self.learning_rate)?;
        count("influence.minibatches", self.minibatches)?;
        positive("influence.sigma_floor", self.sigma_floor)?;
        if self.holdout_every < 2 {
            let range = "at least 2: with 1 no environment would be left to train on";
            return Err(refuse("influence.holdout_every", self.holdout_every, range));
        }
        Ok(())
    }
}

fn refuse(key: &'static str, found: impl ToString, range: &'static str) -> MarlError {
    MarlError::Config { key, found: found.to_string(), range }
}

fn within(
    key: &'static str,
    value: f64,
    allowed: impl std::ops::RangeBounds<f64>,
    range: &'static str,
) -> Result<(), MarlError> {
    if allowed.contains(&value) { Ok(()) } else { Err(refuse(key, value, range)) }
}

fn positive(key: &'static str, value: f64) -> Result<(), MarlError> {
    within(key, value, f64::MIN_POSITIVE..f64::INFINITY, "a finite number above 0")
}

fn not_negative(key: &'static str, value: f64) -> Result<(), MarlError> {
    within(key, value, 0.0..f64::INFINITY, "a finite number of at least 0")
}

fn count(key: &'static str, value: usize) -> Result<(), MarlError> {
    if value > 0 { Ok(()) } else { Err(refuse(key, value, "at least 1")) }
}
