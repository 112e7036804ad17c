//! The learning rules under test, and sizes at which a toy is learnt in a second.

use marl::config::{
    Constant, CountedState, CriticMode, DensityKind, Divergence, Estimator, Fit, QTraining, Reduce,
    Rule, Scored, Sharing, Space, StateNorm,
};
use marl::{
    BehaviourConfig, Config, CriticConfig, InfluenceConfig, MaddpgConfig, SurpriseConfig,
    UpdateConfig,
};
use policy::{CoreKind, PolicyConfig, RefreshHidden};

/// What makes a learning rule of the on-policy kind the one that it is.
pub(crate) struct Variant {
    pub(crate) name: &'static str,
    rule: Rule,
    parameters: Sharing,
    /// Of the entropy bonus, of surprise and of influence.
    weights: (f64, f64, f64),
}

/// The weights are those of `configs/algorithms`.
pub(crate) const ON_POLICY: [Variant; 4] = [
    Variant {
        name: "HAPPO",
        rule: Rule::Happo,
        parameters: Sharing::Separate,
        weights: (0.01, 0.0, 0.0),
    },
    Variant {
        name: "HAPPO-S2MIA",
        rule: Rule::Happo,
        parameters: Sharing::Separate,
        weights: (0.0, 0.01, 0.01),
    },
    Variant {
        name: "MAPPO, one network",
        rule: Rule::Mappo,
        parameters: Sharing::Shared,
        weights: (0.01, 0.0, 0.0),
    },
    Variant {
        name: "MAPPO, a network each",
        rule: Rule::Mappo,
        parameters: Sharing::Separate,
        weights: (0.01, 0.0, 0.0),
    },
];

/// A learning rule and the actors that it trains.
pub(crate) struct Settings {
    pub(crate) config: Config,
    pub(crate) policy: PolicyConfig,
}

/// A variant with actors of `core`.
pub(crate) fn on_policy(variant: &Variant, core: CoreKind) -> Settings {
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
        core,
        encoder: 16,
        hidden: 16,
        width: 16,
        layers: 2,
        chunk_steps: 4,
        burn_in: 0,
        refresh_hidden: RefreshHidden::Never,
        initial_log_std: 1.0,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 0.01,
    }
}

fn config(rule: Rule) -> Config {
    Config {
        update: update(rule),
        critic: CriticConfig {
            mode: CriticMode::PerAgent,
            layers: 1,
            width: 32,
            learning_rate: 5e-3,
            epochs: 5,
            minibatches: 1,
            clip: 0.2,
            huber_delta: 10.0,
            normalizer_beta: 0.9,
            state_norm: StateNorm::None,
            max_gradient_norm: 10.0,
        },
        surprise: surprise(),
        influence: influence(),
        maddpg: MaddpgConfig {
            replay: 20_000,
            batch: 64,
            n_step: 2,
            warm_up: 1000,
            updates_per_step: 0.2,
            noise: 0.2,
            polyak: 0.02,
        },
        behaviour: BehaviourConfig { policy_lag: 0, factor_max: 2.0 },
    }
}

fn update(rule: Rule) -> UpdateConfig {
    UpdateConfig {
        rule,
        parameters: Sharing::Separate,
        gamma: 0.9,
        gae_lambda: 0.95,
        learning_rate_decay: marl::LearningRateDecay::None,
        learning_rate: 5e-3,
        adam_epsilon: 1e-5,
        clip: 0.2,
        epochs: 5,
        minibatches: 1,
        entropy: 0.0,
        max_gradient_norm: 10.0,
        shards: 1,
    }
}

fn influence() -> InfluenceConfig {
    InfluenceConfig {
        lambda: 0.0,
        estimator: Estimator::VariationalKl,
        divergence: Divergence::KlQp,
        q_training: QTraining::Mle,
        kappa: 1.0,
        encoder: 8,
        hidden: 8,
        epochs: 5,
        learning_rate: 5e-3,
        minibatches: 1,
        sigma_floor: 0.05,
        holdout_every: 5,
        lag: 0,
        counted_state: CountedState::Observation,
    }
}

fn surprise() -> SurpriseConfig {
    SurpriseConfig {
        alpha: 0.0,
        density: DensityKind::DiagonalGaussian,
        fit: Fit::Current,
        ema_memory: 0.9,
        space: Space::PolicyObs,
        obs: Scored::Current,
        reduce: Reduce::Sum,
        constant: Constant::Paper,
        clip: 0.0,
        sigma_floor: 0.01,
        mask_below: 1e-4,
        components: 1,
        em_steps: 1,
        vae_hidden: 1,
        vae_latent: 1,
        vae_epochs: 1,
        vae_minibatches: 1,
        vae_learning_rate: 1e-3,
        embedding: 1,
        neighbours: 1,
        references: 2,
    }
}
