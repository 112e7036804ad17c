//! Settings of the update, the critic, surprise and influence. Their defaults are in the binary's configuration files.

mod hasac;
mod influence;
mod maddpg;
mod surprise;

use policy::setting::{SettingError, between, learning_rate, not_negative, positive, within};
use policy::{InputNorm, PolicyConfig};
use serde::{Deserialize, Serialize};

pub use self::hasac::HasacConfig;
pub use self::influence::{Estimator, InfluenceConfig, QTraining};
pub use self::maddpg::MaddpgConfig;
pub use self::surprise::{DensityKind, SurpriseConfig};
use crate::optimisation::learning_rate::LearningRateDecay;
use crate::optimisation::optimizer::AdamConfig;

/// Largest number of units in a layer, as of policies.
const WIDEST: usize = 4096;
/// Most epochs, and most minibatches of one.
const MOST_PASSES: usize = 65_536;

/// Largest weight of a term of the reward or of an objective.
const MOST_WEIGHT: f64 = 1000.0;
/// Fewest and most optimiser steps per environment step of a rule with a replay.
const UPDATES_PER_STEP: (f64, f64) = (1e-4, 10.0);

/// All settings of a learning rule, by section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingConfig {
    /// The policy update.
    pub update: UpdateConfig,
    /// The value function.
    pub critic: CriticConfig,
    /// Surprise minimisation (Eq. 2-4, 9).
    pub surprise: SurpriseConfig,
    /// Influence maximisation (Eq. 5-10).
    pub influence: InfluenceConfig,
    /// Settings of MADDPG only.
    pub maddpg: MaddpgConfig,
    /// Settings of HASAC only; absent with other rules.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hasac: Option<HasacConfig>,
}

/// Settings of a replay and of the learning from it; the sections of the rules describe them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReplaySettings {
    /// Capacity in transitions.
    pub capacity: usize,
    /// Transitions per optimiser step.
    pub batch: usize,
    /// Steps of reward before a target bootstraps.
    pub n_step: usize,
    /// Environment steps before the first optimiser step.
    pub warm_up: u64,
    /// Optimiser steps per environment step after the warm-up.
    pub updates_per_step: f64,
    /// Whether the true state after a termination is stored: HASAC's batch norm reads it, MADDPG's targets do not.
    pub terminal_states: bool,
}

/// How policies are updated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UpdateConfig {
    /// The learning rule.
    pub rule: Rule,
    /// Whether agents share parameters.
    pub parameters: Sharing,
    /// Discount per step, in `[0, 1)`.
    pub gamma: f64,
    /// Decay of the advantage's trace (GAE's lambda), in `[0, 1]`.
    pub gae_lambda: f64,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Decay of the learning rates of actors and critics over a run.
    pub learning_rate_decay: LearningRateDecay,
    /// Adam's epsilon, also for critics and posteriors.
    pub adam_epsilon: f64,
    /// Half width of the interval to which the ratio is clipped.
    pub clip: f64,
    /// Passes over `D_k` per agent.
    pub epochs: usize,
    /// Minibatches per epoch, each an optimiser step.
    pub minibatches: usize,
    /// `KL[old || new]` to which each agent's learning rate is adapted (`optimisation::learning_rate::adapted`), nats.
    /// 0: no adaptation.
    pub desired_kl: f64,
    /// Weight of the entropy bonus.
    pub entropy: f64,
    /// Global norm to which gradients are clipped.
    pub max_gradient_norm: f64,
}

/// The learning rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Heterogeneous-agent PPO: agents are updated one after the other, in random order.
    Happo,
    /// Multi-agent PPO: all agents are updated at the same time.
    Mappo,
    /// Multi-agent deterministic policy gradients from a replay.
    Maddpg,
    /// Heterogeneous-agent soft actor-critic: as MADDPG from a replay, with random policies that are updated one after
    /// the other.
    Hasac,
}

/// Whether agents share parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sharing {
    /// Each agent has its own network.
    Separate,
    /// All agents use one network and must have equal sizes.
    Shared,
}

/// The value function and its training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CriticConfig {
    /// Kind of network.
    pub core: CriticCore,
    /// Normalisation before the first layer; MADDPG's action values have none, HASAC's a batch norm.
    pub input_norm: InputNorm,
    /// Hidden layers.
    pub layers: usize,
    /// Units per layer.
    pub width: usize,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Epochs over `D_k`.
    pub epochs: usize,
    /// Minibatches per epoch, each an optimiser step.
    pub minibatches: usize,
    /// Value clipping: the largest change of a value, normalised units. 0: no clipping.
    pub clip: f64,
    /// Error at which the loss changes from quadratic to linear, normalised units.
    pub huber_delta: f64,
    /// Decay of the returns' running mean and variance per iteration, in `[0, 1)`.
    pub normalizer_beta: f64,
    /// Scaling of the global state before the network.
    pub state_norm: StateNorm,
    /// Global norm to which gradients are clipped.
    pub max_gradient_norm: f64,
}

/// Kind of critic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CriticCore {
    /// Layers of Linear, ReLU, LayerNorm; values depend on the current state only.
    Mlp,
    /// The same layers, then a GRU and a LayerNorm: values also depend on the earlier states of the episode.
    Gru,
}

/// Scaling of the global state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StateNorm {
    /// No scaling.
    None,
    /// Every state by the mean and standard deviation over its features.
    FeatureZ,
    /// Every feature by its running mean and standard deviation.
    Running,
}

impl TrainingConfig {
    /// Rejects values outside their ranges. How values fit together is the caller's to check.
    ///
    /// # Errors
    /// Names the first invalid key and its range.
    pub fn validate(&self) -> Result<(), SettingError> {
        self.update.validate()?;
        self.critic.validate()?;
        self.surprise.validate()?;
        self.influence.validate()?;
        self.maddpg.validate()?;
        self.hasac.as_ref().map_or(Ok(()), HasacConfig::validate)
    }

    /// Settings of the rule's replay; `None` if it has none, or if its section is absent.
    #[must_use]
    pub fn replay(&self) -> Option<ReplaySettings> {
        let (capacity, batch, n_step, warm_up, updates_per_step) = match self.update.rule {
            Rule::Happo | Rule::Mappo => return None,
            Rule::Maddpg => {
                let own = &self.maddpg;
                (own.replay, own.batch, own.n_step, own.warm_up, own.updates_per_step)
            }
            Rule::Hasac => {
                let own = self.hasac.as_ref()?;
                (own.replay, own.batch, own.n_step, own.warm_up, own.updates_per_step)
            }
        };
        let terminal_states = self.update.rule == Rule::Hasac;
        Some(ReplaySettings { capacity, batch, n_step, warm_up, updates_per_step, terminal_states })
    }

    /// Steps of a sequence of the update, `policy.backpropagation_steps`; 1 with a replay, which holds single steps.
    #[must_use]
    pub fn sequence_steps(&self, policy: &PolicyConfig) -> usize {
        if self.replay().is_some() { 1 } else { policy.backpropagation_steps }
    }

    /// How often an environment step is used in an agent's optimiser steps (HASAC: in the critics'), on average: the epochs over
    /// `D_k`, or the transitions drawn from the replay per stored transition after the warm-up.
    #[must_use]
    pub fn sample_reuse(&self) -> f64 {
        let drawn = |replay: ReplaySettings| replay.batch as f64 * replay.updates_per_step;
        self.replay().map_or(self.update.epochs as f64, drawn)
    }
}

impl UpdateConfig {
    /// The optimiser of a policy.
    pub(crate) fn adam(&self) -> AdamConfig {
        let Self { learning_rate, adam_epsilon, max_gradient_norm, .. } = *self;
        AdamConfig { learning_rate, epsilon: adam_epsilon, max_gradient_norm }
    }

    fn validate(&self) -> Result<(), SettingError> {
        within("update.gamma", self.gamma, 0.0..1.0, "0 <= gamma < 1")?;
        within("update.gae_lambda", self.gae_lambda, 0.0..=1.0, "0 <= gae_lambda <= 1")?;
        learning_rate("update.learning_rate", self.learning_rate)?;
        between("update.adam_epsilon", self.adam_epsilon, 1e-12, 1.0)?;
        within("update.clip", self.clip, f64::MIN_POSITIVE..1.0, "0 < clip < 1")?;
        between("update.epochs", self.epochs, 1, MOST_PASSES)?;
        between("update.minibatches", self.minibatches, 1, MOST_PASSES)?;
        not_negative("update.desired_kl", self.desired_kl)?;
        between("update.entropy", self.entropy, 0.0, MOST_WEIGHT)?;
        positive("update.max_gradient_norm", self.max_gradient_norm)
    }
}

impl CriticConfig {
    /// The optimiser of a critic, with the policies' `epsilon`.
    pub(crate) fn adam(&self, epsilon: f64) -> AdamConfig {
        let Self { learning_rate, max_gradient_norm, .. } = *self;
        AdamConfig { learning_rate, epsilon, max_gradient_norm }
    }

    fn validate(&self) -> Result<(), SettingError> {
        between("critic.layers", self.layers, 1, 16)?;
        between("critic.width", self.width, 2, WIDEST)?;
        learning_rate("critic.learning_rate", self.learning_rate)?;
        between("critic.epochs", self.epochs, 1, MOST_PASSES)?;
        between("critic.minibatches", self.minibatches, 1, MOST_PASSES)?;
        not_negative("critic.clip", self.clip)?;
        positive("critic.huber_delta", self.huber_delta)?;
        // Above it the weight of the first update is below the bound of `ValueNormalizer`.
        within("critic.normalizer_beta", self.normalizer_beta, 0.0..=0.99999, "0 to 0.99999")?;
        positive("critic.max_gradient_norm", self.max_gradient_norm)
    }
}
