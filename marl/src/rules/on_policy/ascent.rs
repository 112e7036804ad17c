//! Gradient ascent on the objective of Eq. (10): epochs of minibatches of whole chunks, for one agent or for agents
//! that share parameters.

use std::ops::Range;

use policy::randomness::{Draw, RunSeed};
use rayon::prelude::*;

use super::agent::Agent;
use super::experience::{Experience, Influence};
use super::heads::StepWeights;
use crate::distribution::HeadRows;
use crate::error::MarlError;
use crate::influence::posterior_gradient;
use crate::objective::actor_loss::{Coefficients, Figures, Rows, actor_loss};
use crate::optimisation::gradient::Gradients;
use crate::optimisation::minibatch::minibatches;
use crate::optimisation::shards::{self, Accumulate, shards};

/// Constants of one agent's update, in chunked order.
#[derive(Clone, Copy)]
pub(crate) struct AgentInputs<'a> {
    pub(crate) experience: &'a Experience,
    pub(crate) influence: &'a Influence,
}

/// Metrics of an agent's optimiser steps.
#[derive(Clone, Copy, Default)]
pub(crate) struct AscentMetrics {
    pub(crate) figures: Figures,
    pub(crate) gradient_norm: f64,
    /// Number of optimiser steps. All figures are sums over them until [`AscentMetrics::mean`].
    steps: usize,
    /// Number of steps skipped because their gradient was not finite.
    pub(crate) skipped: i64,
    /// Learning rate of the steps.
    pub(crate) learning_rate: f64,
}

impl AscentMetrics {
    /// Adds one optimiser step.
    fn add(&mut self, figures: &Figures, gradient_norm: f64) {
        self.figures.add(1.0, figures);
        self.gradient_norm += gradient_norm;
        self.steps += 1;
    }

    /// Adds the steps of an epoch.
    fn add_epoch(&mut self, epoch: &Self) {
        self.figures.add(1.0, &epoch.figures);
        self.gradient_norm += epoch.gradient_norm;
        self.steps += epoch.steps;
    }

    /// Means over all optimiser steps.
    fn mean(self) -> Self {
        let share = 1.0 / self.steps as f64;
        let mut figures = Figures::default();
        figures.add(share, &self.figures);
        Self { figures, gradient_norm: share * self.gradient_norm, ..self }
    }
}

/// Trains one agent, with its advantages weighted by `factor`, `[L, C]`.
pub(crate) fn maximise(
    agent: &mut Agent,
    inputs: AgentInputs<'_>,
    factor: &[f64],
    (seed, draw): (RunSeed, Draw),
) -> Result<AscentMetrics, MarlError> {
    let (epochs, parts) = (agent.update.epochs, agent.update.minibatches);
    let mut trained = AscentMetrics::default();
    for epoch in 0..epochs {
        let mut done = AscentMetrics::default();
        let draw = draw.step(epoch as u32);
        for columns in minibatches(inputs.experience.sequences.layout.chunks, parts, seed, draw) {
            let (figures, gradients) = gradient(agent, inputs, factor, &columns)?;
            let norm = agent.adam.step(&agent.trainable, &gradients)?;
            agent.project()?;
            done.add(&figures, norm);
        }
        trained.add_epoch(&done);
    }
    (trained.skipped, trained.learning_rate) = (agent.adam.skipped(), agent.adam.learning_rate());
    Ok(trained.mean())
}

/// Trains agents that share one network with the optimiser of agent 0. Each step uses the mean of their gradients, as
/// if a minibatch contained the rows of all agents. `draws` has one key per agent.
pub(crate) fn maximise_together(
    agents: &mut [Agent],
    inputs: &[AgentInputs<'_>],
    factor: &[f64],
    (seed, draws): (RunSeed, &[Draw]),
) -> Result<Vec<AscentMetrics>, MarlError> {
    let (epochs, parts) = (agents[0].update.epochs, agents[0].update.minibatches);
    let mut trained = vec![AscentMetrics::default(); agents.len()];
    for epoch in 0..epochs {
        let mut done = vec![AscentMetrics::default(); agents.len()];
        let split = |(draw, inputs): (&Draw, &AgentInputs<'_>)| {
            minibatches(
                inputs.experience.sequences.layout.chunks,
                parts,
                seed,
                draw.step(epoch as u32),
            )
        };
        let epoch_minibatches: Vec<_> = draws.iter().zip(inputs).map(split).collect();
        for part in 0..epoch_minibatches[0].len() {
            let columns: Vec<&[usize]> =
                epoch_minibatches.iter().map(|own| own[part].as_slice()).collect();
            let one =
                |index: usize| gradient(&agents[index], inputs[index], factor, columns[index]);
            let found = (0..agents.len()).into_par_iter().map(one);
            let (figures, gradients): (Vec<_>, Vec<_>) =
                found.collect::<Result<Vec<_>, MarlError>>()?.into_iter().unzip();
            let mean = Gradients::mean(gradients);
            let first = &mut agents[0];
            let norm = first.adam.step(&first.trainable, &mean)?;
            first.project()?;
            for (done, figures) in done.iter_mut().zip(&figures) {
                done.add(figures, norm);
            }
        }
        trained.iter_mut().zip(&done).for_each(|(all, done)| all.add_epoch(done));
    }
    let (skipped, learning_rate) = (agents[0].adam.skipped(), agents[0].adam.learning_rate());
    let one = |all: AscentMetrics| AscentMetrics { skipped, learning_rate, ..all.mean() };
    Ok(trained.into_iter().map(one).collect())
}

/// The gradient of a minibatch. Each shard has a separate graph. Shards are added in a fixed tree, so the sum does not
/// depend on the number of threads.
pub(super) fn gradient(
    agent: &Agent,
    inputs: AgentInputs<'_>,
    factor: &[f64],
    columns: &[usize],
) -> Result<(Figures, Gradients), MarlError> {
    let weights = agent.step_weights()?;
    let total = columns.len();
    let shards = shards(total, inputs.experience.sequences.layout.steps);
    let one = |range: Range<usize>| shard(agent, &weights, inputs, factor, &columns[range], total);
    shards::sum(&shards, &one)
}

fn shard(
    agent: &Agent,
    weights: &StepWeights<'_>,
    AgentInputs { experience, influence }: AgentInputs<'_>,
    factor: &[f64],
    columns: &[usize],
    total: usize,
) -> Result<(Figures, Gradients), MarlError> {
    let sequences = &experience.sequences;
    let layout = experience.sequences.layout;
    let (head, second) = agent.heads(weights, experience, columns)?;
    let p = HeadRows::of(&head)?;
    let q = second.as_ref().map(HeadRows::of).transpose()?;
    let inputs = || influence.conditional.as_ref().map(|q| q.columns(layout, columns));
    let rows = Rows {
        action: layout.columns(&sequences.action, p.action_size(), columns),
        log_prob_old: layout.columns(&experience.log_prob, 1, columns),
        advantage: layout.columns(&experience.advantage, 1, columns),
        factor: layout.columns(factor, 1, columns),
        posterior: q.clone().or_else(inputs),
        signal: layout.columns(&sequences.signal, sequences.signal.len() / layout.rows(), columns),
        others_precision: influence.others_precision.clone(),
    };
    let total = layout.steps * total;
    let (figures, gradient) = actor_loss(&p, &rows, total, &agent.coefficients);
    let mut root = gradient.root(&head)?;
    if let (Some(second), Some(q)) = (&second, &q) {
        let Coefficients { lambda, kappa, .. } = agent.coefficients;
        let gradient = posterior_gradient(-lambda / total as f64, q, &p, kappa);
        root = (root + gradient.root(second)?)?;
    }
    Ok((figures, Gradients::of(&agent.trainable, &root)?))
}

impl Accumulate for Figures {
    fn accumulate(&mut self, next: &Self) {
        self.add(1.0, next);
    }
}

/// Change of a policy since its rollout.
pub(crate) struct PolicyChange {
    /// Log-probabilities of all actions under the current weights, `[L, C]`, nats.
    pub(crate) log_prob: Vec<f64>,
    /// Mean of `KL[old || new]` over all rows, given the signal that agents share, in closed form, nats.
    pub(crate) kl: f64,
}

/// Evaluates the current weights on all rows.
pub(crate) fn policy_change(
    agent: &Agent,
    experience: &Experience,
) -> Result<PolicyChange, MarlError> {
    let (now, log_prob, _) = agent.evaluate(&experience.sequences)?;
    let signal = &experience.sequences.signal;
    let divergences = experience.behaviour.given(signal).kl_divergences(&now.given(signal));
    let kl = divergences.iter().sum::<f64>();
    Ok(PolicyChange { log_prob, kl: kl / experience.sequences.layout.rows() as f64 })
}
