//! The learning rules under test, and sizes with which a small task is learnt in a second.

use marl::TrainingConfig;
use marl::config::{CriticCore, Rule, Sharing};
use policy::{CoreKind, PolicyConfig};

use crate::fixture;

/// Settings of a learning rule and its actors.
pub(crate) struct Settings {
    pub(crate) name: String,
    pub(crate) config: TrainingConfig,
    pub(crate) policy: PolicyConfig,
}

/// The on-policy rules with both cores, with the weights of entropy bonus, surprise and influence of
/// `configs/algorithms`.
pub(crate) fn on_policy() -> Vec<Settings> {
    let variants = [
        ("HAPPO", Rule::Happo, Sharing::Separate, [0.01, 0.0, 0.0]),
        ("HAPPO-S2MIA", Rule::Happo, Sharing::Separate, [0.0, 0.01, 0.01]),
        ("MAPPO, one network", Rule::Mappo, Sharing::Shared, [0.01, 0.0, 0.0]),
        ("MAPPO, a network each", Rule::Mappo, Sharing::Separate, [0.01, 0.0, 0.0]),
    ];
    let cores = [CoreKind::Gru, CoreKind::Mlp];
    variants.into_iter().flat_map(|variant| cores.map(|core| settings(variant, core))).collect()
}

/// HAPPO in which all agents update one network in turn.
pub(crate) fn happo_with_one_network() -> Settings {
    settings(("HAPPO, one network", Rule::Happo, Sharing::Shared, [0.0; 3]), CoreKind::Mlp)
}

/// HAPPO with a recurrent critic; with surprise, the critic has a value for each agent.
pub(crate) fn happo_with_recurrent_critics() -> [Settings; 2] {
    [("a value", 0.0), ("a value each", 0.01)].map(|(name, alpha)| {
        let mut found =
            settings((name, Rule::Happo, Sharing::Separate, [0.0, alpha, 0.0]), CoreKind::Mlp);
        found.config.critic.core = CriticCore::Gru;
        found
    })
}

fn settings(
    (name, rule, parameters, [entropy, alpha, lambda]): (&str, Rule, Sharing, [f64; 3]),
    core: CoreKind,
) -> Settings {
    let mut config = config(rule);
    (config.update.parameters, config.update.entropy) = (parameters, entropy);
    (config.surprise.alpha, config.influence.lambda) = (alpha, lambda);
    Settings { name: format!("{name}, {core:?}"), config, policy: policy(core) }
}

/// MADDPG, whose actors have no memory.
pub(crate) fn maddpg() -> Settings {
    let mut config = config(Rule::Maddpg);
    config.critic.layers = 2;
    config.critic.learning_rate = 2e-3;
    config.update.learning_rate = 1e-3;
    Settings { name: "MADDPG".to_owned(), config, policy: policy(CoreKind::Mlp) }
}

/// HASAC, whose actors have no memory either.
pub(crate) fn hasac() -> Settings {
    let mut config = config(Rule::Hasac);
    config.critic.layers = 2;
    (config.critic.learning_rate, config.update.learning_rate) = (3e-3, 3e-3);
    Settings { name: "HASAC".to_owned(), config, policy: policy(CoreKind::Mlp) }
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
    let mut config = fixture::config(rule);
    config.update.learning_rate = 5e-3;
    let critic = &mut config.critic;
    critic.width = 32;
    critic.minibatches = 1;
    critic.learning_rate = 5e-3;
    critic.normalizer_beta = 0.9;
    let influence = &mut config.influence;
    influence.epochs = 5;
    influence.minibatches = 1;
    influence.learning_rate = 5e-3;
    let maddpg = &mut config.maddpg;
    maddpg.replay = 20_000;
    maddpg.warm_up = 1000;
    maddpg.updates_per_step = 0.2;
    maddpg.noise = 0.2;
    maddpg.polyak = 0.02;
    let hasac = config.hasac.as_mut().unwrap();
    hasac.replay = 20_000;
    hasac.batch = 64;
    hasac.warm_up = 1000;
    hasac.updates_per_step = 0.2;
    config
}
