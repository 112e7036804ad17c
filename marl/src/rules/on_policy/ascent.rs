//! Up the objective of Eq. (10): epochs of minibatches of whole chunks, for one agent or for agents
//! that share their parameters.

use std::ops::Range;

use policy::randomness::{Draw, RunSeed};
use rayon::prelude::*;

use super::agent::{Agent, Experience, Influence};
use super::heads::StepWeights;
use crate::distribution::HeadRows;
use crate::error::MarlError;
use crate::objective::actor_loss::{Coefficients, Figures, Rows, actor_loss};
use crate::optimisation::gradient::Gradients;
use crate::optimisation::minibatch::minibatches;
use crate::optimisation::shards::{self, Share, shards};

/// What is constant during the update of one agent, all in chunked order.
#[derive(Clone, Copy)]
pub(crate) struct PerAgent<'a> {
    pub(crate) experience: &'a Experience,
    pub(crate) influence: &'a Influence,
}

/// What an agent's optimiser steps came to.
#[derive(Clone, Copy, Default)]
pub(crate) struct Trained {
    pub(crate) figures: Figures,
    pub(crate) gradient_norm: f64,
    /// Optimiser steps made; all figures are sums over them until [`Trained::mean`].
    steps: usize,
    /// Epochs gone through.
    pub(crate) epochs: usize,
    /// Steps skipped so far because their gradient was not finite.
    pub(crate) skipped: i64,
    /// Size of the steps.
    pub(crate) learning_rate: f64,
}

impl Trained {
    /// Counts one optimiser step.
    fn add(&mut self, figures: &Figures, gradient_norm: f64) {
        self.figures.add(1.0, figures);
        self.gradient_norm += gradient_norm;
        self.steps += 1;
    }

    /// Counts the steps of an epoch; their mean estimate of `KL[old || new]`, nats.
    fn add_epoch(&mut self, epoch: &Self) -> f64 {
        self.figures.add(1.0, &epoch.figures);
        self.gradient_norm += epoch.gradient_norm;
        self.steps += epoch.steps;
        self.epochs += 1;
        epoch.figures.approx_kl / epoch.steps as f64
    }

    /// Means over all optimiser steps.
    fn mean(self) -> Self {
        let share = 1.0 / self.steps as f64;
        let mut figures = Figures::default();
        figures.add(share, &self.figures);
        Self { figures, gradient_norm: share * self.gradient_norm, ..self }
    }
}

/// One agent by itself, its advantages weighed with `factor`, `[L, C]`. It stops after the first epoch in which it moved
/// as far as `kl_limit`, nats.
pub(crate) fn maximise(
    agent: &mut Agent,
    known: PerAgent<'_>,
    factor: &[f64],
    kl_limit: f64,
    (seed, draw): (RunSeed, Draw),
) -> Result<Trained, MarlError> {
    let (epochs, parts) = (agent.update.epochs, agent.update.minibatches);
    let mut trained = Trained::default();
    for epoch in 0..epochs {
        let mut done = Trained::default();
        agent.refresh_states(&known.experience.sequences, epoch)?;
        let draw = draw.step(epoch as u32);
        for columns in minibatches(known.experience.sequences.layout.chunks, parts, seed, draw) {
            let (figures, gradients) = gradient(agent, known, factor, &columns)?;
            let norm = agent.adam.step(&agent.trainable, &gradients)?;
            agent.project()?;
            done.add(&figures, norm);
        }
        if trained.add_epoch(&done) >= kl_limit {
            break;
        }
    }
    (trained.skipped, trained.learning_rate) = (agent.adam.skipped(), agent.adam.learning_rate());
    Ok(trained.mean())
}

/// Agents that share one network, whose optimiser is the first one's: each step follows the mean of
/// their gradients, as if a minibatch held the rows of all of them. `draws` are the agents' own. They stop after the
/// first epoch in which they together moved as far as `kl_limit`, nats.
pub(crate) fn maximise_together(
    agents: &mut [Agent],
    known: &[PerAgent<'_>],
    factor: &[f64],
    kl_limit: f64,
    (seed, draws): (RunSeed, &[Draw]),
) -> Result<Vec<Trained>, MarlError> {
    let (epochs, parts) = (agents[0].update.epochs, agents[0].update.minibatches);
    let mut trained = vec![Trained::default(); agents.len()];
    for epoch in 0..epochs {
        let mut done = vec![Trained::default(); agents.len()];
        for (agent, known) in agents.iter_mut().zip(known) {
            agent.refresh_states(&known.experience.sequences, epoch)?;
        }
        let deal = |(draw, known): (&Draw, &PerAgent<'_>)| {
            minibatches(
                known.experience.sequences.layout.chunks,
                parts,
                seed,
                draw.step(epoch as u32),
            )
        };
        let dealt: Vec<_> = draws.iter().zip(known).map(deal).collect();
        for part in 0..dealt[0].len() {
            let columns: Vec<&[usize]> = dealt.iter().map(|own| own[part].as_slice()).collect();
            let one = |index: usize| gradient(&agents[index], known[index], factor, columns[index]);
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
        let moved = trained.iter_mut().zip(&done).map(|(all, done)| all.add_epoch(done));
        if moved.sum::<f64>() >= kl_limit {
            break;
        }
    }
    let (skipped, learning_rate) = (agents[0].adam.skipped(), agents[0].adam.learning_rate());
    let one = |all: Trained| Trained { skipped, learning_rate, ..all.mean() };
    Ok(trained.into_iter().map(one).collect())
}

/// The gradient of a minibatch: shards, each a graph of its own, added in a fixed tree, so that the sum does not depend
/// on how many threads computed it.
pub(super) fn gradient(
    agent: &Agent,
    known: PerAgent<'_>,
    factor: &[f64],
    columns: &[usize],
) -> Result<(Figures, Gradients), MarlError> {
    let (weights, total) = (agent.step_weights()?, columns.len());
    let shards = shards(total, known.experience.sequences.layout.steps);
    let one = |range: Range<usize>| shard(agent, &weights, known, factor, &columns[range], total);
    shards::sum(&shards, &one)
}

fn shard(
    agent: &Agent,
    weights: &StepWeights<'_>,
    PerAgent { experience, influence }: PerAgent<'_>,
    factor: &[f64],
    columns: &[usize],
    total: usize,
) -> Result<(Figures, Gradients), MarlError> {
    let (sequences, layout) = (&experience.sequences, experience.sequences.layout);
    let (head, second) = agent.heads(weights, experience, columns)?;
    let p = HeadRows::of(&head)?;
    let q = second.as_ref().map(HeadRows::of).transpose()?;
    let known = || influence.conditional.as_ref().map(|q| q.columns(layout, columns));
    let rows = Rows {
        action: layout.columns(&sequences.action, p.action_size(), columns),
        log_prob_old: layout.columns(&experience.log_prob, 1, columns),
        advantage: layout.columns(&experience.advantage, 1, columns),
        factor: layout.columns(factor, 1, columns),
        posterior: q.clone().or_else(known),
    };
    let total = layout.steps * total;
    let (figures, gradient) = actor_loss(&p, &rows, total, &agent.coefficients);
    let mut root = gradient.root(&head)?;
    if let (Some(second), Some(q)) = (&second, &q) {
        let Coefficients { lambda, term, .. } = agent.coefficients;
        let gradient = term.posterior_gradient(-lambda / total as f64, q, &p);
        root = (root + gradient.root(second)?)?;
    }
    Ok((figures, Gradients::of(&agent.trainable, &root)?))
}

impl Share for Figures {
    fn add_share(&mut self, next: &Self) {
        self.add(1.0, next);
    }
}

/// What became of a policy since its data were collected.
pub(crate) struct Moved {
    /// Log-densities of all actions under today's weights, `[L, C]`, nats.
    pub(crate) log_prob: Vec<f64>,
    /// Mean of `KL[old || new]` over all rows, in closed form, nats.
    pub(crate) kl: f64,
}

/// Today's weights asked about all rows.
pub(crate) fn moved(agent: &Agent, experience: &Experience) -> Result<Moved, MarlError> {
    let (now, log_prob, _) = agent.asked(&experience.sequences)?;
    let kl = experience.behaviour.kl_divergences(&now).iter().sum::<f64>();
    Ok(Moved { log_prob, kl: kl / experience.sequences.layout.rows() as f64 })
}
