//! Settings of the reference updates: those of the file, and sizes from its arrays.

use marl::config::{Rule, Sharing};
use marl::{
    ActionKind, AgentBatch, AgentShape, Batch, CriticConfig, Final, InfluenceConfig, MaddpgConfig,
    Problem, SurpriseConfig, TrainingConfig, UpdateConfig,
};
use policy::{CoreKind, PolicyConfig};

use crate::file::Reference;
use crate::fixture;

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
    };
    Problem { agents: (0..AGENTS).map(agent).collect(), state: axis(reference, "batch/state", 2) }
}

pub(crate) fn policy(reference: &Reference, core: CoreKind) -> PolicyConfig {
    PolicyConfig {
        encoder: 5,
        hidden: 6,
        width: 7,
        layers: 2,
        backpropagation_steps: 5,
        sigma_floor: reference.setting("policy.sigma_floor") as f32,
        ..fixture::policy(core)
    }
}

/// Surprise has a weight, so that there is a value per agent. The rewards are those of the file.
pub(crate) fn config(reference: &Reference, rule: Rule, parameters: Sharing) -> TrainingConfig {
    let number = |key: &str| reference.setting(key);
    let usual = fixture::config(rule);
    TrainingConfig {
        update: UpdateConfig {
            parameters,
            gamma: number("update.gamma"),
            gae_lambda: number("update.gae_lambda"),
            learning_rate: number("update.learning_rate"),
            adam_epsilon: number("update.adam_epsilon"),
            clip: number("update.clip"),
            epochs: number("update.epochs") as usize,
            entropy: number("update.entropy"),
            max_gradient_norm: number("update.max_gradient_norm"),
            ..usual.update
        },
        critic: CriticConfig {
            layers: 2,
            width: 7,
            learning_rate: number("critic.learning_rate"),
            epochs: number("critic.epochs") as usize,
            minibatches: 1,
            clip: number("critic.clip"),
            huber_delta: number("critic.huber_delta"),
            normalizer_beta: number("critic.normalizer_beta"),
            max_gradient_norm: number("critic.max_gradient_norm"),
            ..usual.critic
        },
        surprise: SurpriseConfig { alpha: 0.01, ..usual.surprise },
        influence: influence(reference, usual.influence),
        maddpg: maddpg(reference, usual.maddpg),
    }
}

fn influence(reference: &Reference, usual: InfluenceConfig) -> InfluenceConfig {
    InfluenceConfig {
        lambda: reference.setting("influence.lambda"),
        kappa: reference.setting("influence.kappa"),
        encoder: 5,
        hidden: 6,
        epochs: reference.setting("influence.epochs") as usize,
        learning_rate: reference.setting("influence.learning_rate"),
        minibatches: 1,
        posterior_sigma_floor: reference.setting("policy.sigma_floor"),
        holdout_every: reference.setting("influence.holdout_every") as usize,
        ..usual
    }
}

/// One optimiser step from an iteration of 50 transitions.
fn maddpg(reference: &Reference, usual: MaddpgConfig) -> MaddpgConfig {
    MaddpgConfig {
        replay: 50,
        batch: 16,
        n_step: reference.setting("maddpg.n_step") as usize,
        warm_up: 0,
        updates_per_step: 0.02,
        polyak: reference.setting("maddpg.polyak"),
        ..usual
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

/// State and observations after row `row`.
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
