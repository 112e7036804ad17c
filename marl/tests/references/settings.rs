//! What the reference updates are told: the file's settings, and sizes that its arrays have.

use marl::config::{
    Constant, CountedState, CriticMode, DensityKind, Divergence, Estimator, Fit, QTraining, Reduce,
    Rule, Scored, Sharing, Space, StateNorm,
};
use marl::{
    ActionKind, AgentBatch, AgentShape, Batch, BehaviourConfig, Config, CriticConfig, Final,
    InfluenceConfig, MaddpgConfig, Problem, SurpriseConfig, UpdateConfig,
};
use policy::{CoreKind, PolicyConfig, RefreshHidden};

use crate::file::Reference;

pub(crate) const AGENTS: usize = 2;

fn axis(reference: &Reference, name: &str, axis: usize) -> usize {
    reference.array(name).shape()[axis]
}

pub(crate) fn problem(reference: &Reference) -> Problem {
    let agent = |index: usize| AgentShape {
        observation: axis(reference, &format!("batch/observation_{index}"), 2),
        action: axis(reference, &format!("batch/action_{index}"), 2),
        action_range: (-1.0, 2.0),
        kind: ActionKind::Continuous,
        surprise_features: vec![0],
        seen: vec![],
        near: vec![],
    };
    Problem { agents: (0..AGENTS).map(agent).collect(), state: axis(reference, "batch/state", 2) }
}

pub(crate) fn policy(reference: &Reference, core: CoreKind) -> PolicyConfig {
    PolicyConfig {
        core,
        encoder: 5,
        hidden: 6,
        width: 7,
        layers: 2,
        chunk_steps: 5,
        burn_in: 0,
        refresh_hidden: RefreshHidden::Never,
        initial_log_std: 1.0,
        sigma_scale: 0.5,
        sigma_floor: reference.setting("policy.sigma_floor") as f32,
        head_gain: 0.01,
    }
}

pub(crate) fn config(reference: &Reference, rule: Rule, parameters: Sharing) -> Config {
    let count = |key: &str| reference.setting(key) as usize;
    let update = UpdateConfig {
        rule,
        parameters,
        gamma: reference.setting("update.gamma"),
        gae_lambda: reference.setting("update.gae_lambda"),
        learning_rate: reference.setting("update.learning_rate"),
        learning_rate_decay: marl::LearningRateDecay::None,
        adam_epsilon: reference.setting("update.adam_epsilon"),
        clip: reference.setting("update.clip"),
        epochs: count("update.epochs"),
        minibatches: 1,
        entropy: reference.setting("update.entropy"),
        max_gradient_norm: reference.setting("update.max_gradient_norm"),
        shards: 3,
    };
    let critic = CriticConfig {
        mode: CriticMode::PerAgent,
        layers: 2,
        width: 7,
        learning_rate: reference.setting("critic.learning_rate"),
        epochs: count("critic.epochs"),
        minibatches: 1,
        clip: reference.setting("critic.clip"),
        huber_delta: reference.setting("critic.huber_delta"),
        normalizer_beta: reference.setting("critic.normalizer_beta"),
        state_norm: StateNorm::None,
        max_gradient_norm: reference.setting("critic.max_gradient_norm"),
    };
    let influence = influence(reference);
    let behaviour = BehaviourConfig { policy_lag: 0, factor_max: 2.0 };
    Config { update, critic, surprise: unread(), influence, maddpg: maddpg(reference), behaviour }
}

fn influence(reference: &Reference) -> InfluenceConfig {
    InfluenceConfig {
        lambda: reference.setting("influence.lambda"),
        estimator: Estimator::VariationalKl,
        divergence: Divergence::KlQp,
        q_training: QTraining::Mle,
        kappa: reference.setting("influence.kappa"),
        encoder: 5,
        hidden: 6,
        epochs: reference.setting("influence.epochs") as usize,
        learning_rate: reference.setting("influence.learning_rate"),
        minibatches: 1,
        sigma_floor: reference.setting("policy.sigma_floor"),
        holdout_every: reference.setting("influence.holdout_every") as usize,
        lag: 0,
        counted_state: CountedState::Observation,
    }
}

/// One optimiser step from an iteration of 50 transitions.
fn maddpg(reference: &Reference) -> MaddpgConfig {
    MaddpgConfig {
        replay: 50,
        batch: 16,
        n_step: reference.setting("maddpg.n_step") as usize,
        warm_up: 0,
        updates_per_step: 0.02,
        noise: 0.1,
        polyak: reference.setting("maddpg.polyak"),
    }
}

/// An update takes rewards as they come.
fn unread() -> SurpriseConfig {
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
        components: 3,
        em_steps: 20,
        vae_hidden: 16,
        vae_latent: 2,
        vae_epochs: 5,
        vae_minibatches: 4,
        vae_learning_rate: 1e-2,
        embedding: 4,
        neighbours: 3,
        references: 256,
    }
}

pub(crate) fn batch(reference: &Reference) -> Batch {
    let agent = |index: usize| AgentBatch {
        observation: reference.single(&format!("batch/observation_{index}")),
        action: reference.single(&format!("batch/action_{index}")),
        log_prob: vec![0.0; reference.numbers("batch/terminated").len()],
        hidden: reference.single(&format!("batch/hidden_{index}")),
    };
    let mut batch = Batch {
        steps: axis(reference, "batch/state", 0),
        environments: axis(reference, "batch/state", 1),
        agents: (0..AGENTS).map(agent).collect(),
        state: reference.single("batch/state"),
        reward: reference.single("batch/rewards_0"),
        terminated: reference.flags("batch/terminated"),
        truncated: reference.flags("batch/truncated"),
        finals: Vec::new(),
    };
    let rows = 0..batch.rows();
    let ended = rows.filter(|&row| batch.done(row) || row / batch.environments + 1 == batch.steps);
    batch.finals = ended.map(|row| last(reference, row, batch.environments)).collect();
    batch
}

/// What was true after row `row`.
fn last(reference: &Reference, row: usize, environments: usize) -> Final {
    let part = |name: &str| {
        let width = axis(reference, name, 2);
        reference.single(name)[row * width..(row + 1) * width].to_vec()
    };
    let observation = |index: usize| part(&format!("batch/final_observation_{index}"));
    Final {
        step: row / environments,
        environment: row % environments,
        state: part("batch/final_state"),
        observation: (0..AGENTS).map(observation).collect(),
    }
}
