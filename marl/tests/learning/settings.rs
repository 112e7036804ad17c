//! The learning rules under test, and sizes with which a small task is learnt in a second.

use marl::config::{Rule, Sharing};
use marl::{CriticConfig, InfluenceConfig, MaddpgConfig, TrainingConfig, UpdateConfig};
use policy::{CoreKind, PolicyConfig};

use crate::fixture;

/// Settings that distinguish the on-policy rules.
pub(crate) struct RuleVariant {
    pub(crate) name: &'static str,
    rule: Rule,
    parameters: Sharing,
    /// Weights of the entropy bonus, of surprise and of influence.
    weights: (f64, f64, f64),
}

/// The weights of `configs/algorithms`.
pub(crate) const ON_POLICY: [RuleVariant; 4] = [
    RuleVariant {
        name: "HAPPO",
        rule: Rule::Happo,
        parameters: Sharing::Separate,
        weights: (0.01, 0.0, 0.0),
    },
    RuleVariant {
        name: "HAPPO-S2MIA",
        rule: Rule::Happo,
        parameters: Sharing::Separate,
        weights: (0.0, 0.01, 0.01),
    },
    RuleVariant {
        name: "MAPPO, one network",
        rule: Rule::Mappo,
        parameters: Sharing::Shared,
        weights: (0.01, 0.0, 0.0),
    },
    RuleVariant {
        name: "MAPPO, a network each",
        rule: Rule::Mappo,
        parameters: Sharing::Separate,
        weights: (0.01, 0.0, 0.0),
    },
];

/// Settings of a learning rule and its actors.
pub(crate) struct Settings {
    pub(crate) config: TrainingConfig,
    pub(crate) policy: PolicyConfig,
}

/// A variant with actors of `core`.
pub(crate) fn on_policy(variant: &RuleVariant, core: CoreKind) -> Settings {
    let (entropy, alpha, lambda) = variant.weights;
    let mut config = config(variant.rule);
    config.update.parameters = variant.parameters;
    config.update.entropy = entropy;
    config.surprise.alpha = alpha;
    config.influence.lambda = lambda;
    Settings { config, policy: policy(core) }
}

/// MADDPG, whose actors have no memory.
pub(crate) fn maddpg() -> Settings {
    let mut config = config(Rule::Maddpg);
    config.critic.layers = 2;
    config.critic.learning_rate = 2e-3;
    config.update.learning_rate = 1e-3;
    Settings { config, policy: policy(CoreKind::Mlp) }
}

fn policy(core: CoreKind) -> PolicyConfig {
    PolicyConfig {
        encoder: 16,
        hidden: 16,
        width: 16,
        layers: 2,
        backpropagation_steps: 4,
        ..fixture::policy(core)
    }
}

fn config(rule: Rule) -> TrainingConfig {
    let usual = fixture::config(rule);
    TrainingConfig {
        update: UpdateConfig { learning_rate: 5e-3, ..usual.update },
        critic: CriticConfig {
            width: 32,
            learning_rate: 5e-3,
            minibatches: 1,
            normalizer_beta: 0.9,
            ..usual.critic
        },
        influence: InfluenceConfig {
            epochs: 5,
            learning_rate: 5e-3,
            minibatches: 1,
            ..usual.influence
        },
        maddpg: MaddpgConfig {
            replay: 20_000,
            warm_up: 1000,
            updates_per_step: 0.2,
            noise: 0.2,
            polyak: 0.02,
            ..usual.maddpg
        },
        ..usual
    }
}
