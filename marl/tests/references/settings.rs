//! Settings of the reference updates: those of the file, and sizes from its arrays.

use marl::config::{HasacConfig, Rule, Sharing};
use marl::{ActionKind, AgentBatch, AgentShape, Batch, Final, Problem, TrainingConfig};
use policy::{CoreKind, PolicyConfig};

use crate::file::ReferenceValues;
use crate::fixture;

pub(crate) const AGENTS: usize = 2;

fn axis(reference: &ReferenceValues, name: &str, axis: usize) -> usize {
    reference.array(name).shape()[axis]
}

pub(crate) fn problem(reference: &ReferenceValues) -> Problem {
    let agent = |index: usize| AgentShape {
        observation: axis(reference, &format!("batch/observation_{index}"), 2),
        action: axis(reference, &format!("batch/action_{index}"), 2),
        action_range: (-1.0, 2.0),
        kind: ActionKind::Continuous,
        surprise_features: vec![0],
    };
    Problem { agents: (0..AGENTS).map(agent).collect(), state: axis(reference, "batch/state", 2) }
}

pub(crate) fn policy(reference: &ReferenceValues, core: CoreKind) -> PolicyConfig {
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

/// Surprise has a weight, so that there is a value per agent. The rewards are those of the file. MADDPG makes one
/// optimiser step from an iteration of 50 transitions, HASAC two.
pub(crate) fn config(
    reference: &ReferenceValues,
    rule: Rule,
    parameters: Sharing,
) -> TrainingConfig {
    let number = |key: &str| reference.setting(key);
    let mut config = fixture::config(rule);
    let update = &mut config.update;
    update.parameters = parameters;
    update.gamma = number("update.gamma");
    update.gae_lambda = number("update.gae_lambda");
    update.learning_rate = number("update.learning_rate");
    update.adam_epsilon = number("update.adam_epsilon");
    update.clip = number("update.clip");
    update.epochs = number("update.epochs") as usize;
    update.entropy = number("update.entropy");
    update.max_gradient_norm = number("update.max_gradient_norm");
    let critic = &mut config.critic;
    critic.layers = 2;
    critic.width = 7;
    critic.minibatches = 1;
    critic.learning_rate = number("critic.learning_rate");
    critic.epochs = number("critic.epochs") as usize;
    critic.clip = number("critic.clip");
    critic.huber_delta = number("critic.huber_delta");
    critic.normalizer_beta = number("critic.normalizer_beta");
    critic.max_gradient_norm = number("critic.max_gradient_norm");
    config.surprise.alpha = 0.01;
    let influence = &mut config.influence;
    influence.encoder = 5;
    influence.hidden = 6;
    influence.minibatches = 1;
    influence.lambda = number("influence.lambda");
    influence.kappa = number("influence.kappa");
    influence.epochs = number("influence.epochs") as usize;
    influence.learning_rate = number("influence.learning_rate");
    influence.posterior_sigma_floor = number("policy.sigma_floor");
    influence.holdout_every = number("influence.holdout_every") as usize;
    let maddpg = &mut config.maddpg;
    maddpg.replay = 50;
    maddpg.batch = 16;
    maddpg.warm_up = 0;
    maddpg.n_step = number("maddpg.n_step") as usize;
    maddpg.updates_per_step = 0.02;
    maddpg.polyak = number("maddpg.polyak");
    if rule == Rule::Hasac {
        config.hasac = Some(hasac(reference));
    }
    config
}

/// Two optimiser steps from an iteration of 50 transitions; the policies take part in the first.
fn hasac(reference: &ReferenceValues) -> HasacConfig {
    let number = |key: &str| reference.setting(key);
    HasacConfig {
        replay: 50,
        batch: number("hasac.batch") as usize,
        n_step: number("maddpg.n_step") as usize,
        warm_up: 0,
        updates_per_step: 0.04,
        policy_every: 2,
        norm_momentum: number("hasac.norm_momentum"),
        initial_temperature: number("hasac.initial_temperature"),
        first_moment: number("hasac.first_moment"),
    }
}

pub(crate) fn batch(reference: &ReferenceValues) -> Batch {
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
fn last(reference: &ReferenceValues, row: usize, environments: usize) -> Final {
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
