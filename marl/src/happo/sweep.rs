//! The sweep itself: agent after agent, each weighing its advantage with what the ones before it did.

use candle_core::DType;
use policy::randomness::{Draw, Purpose, RunSeed};
use policy::{ActorPolicy, Head};
use rayon::prelude::*;

use super::PerAgent;
use super::agent::{Agent, Experience, Influence};
use crate::actor_loss::{Figures, Rows};
use crate::algorithm::Report;
use crate::error::MarlError;
use crate::gaussian;
use crate::gradient::Gradients;
use crate::head_rows::HeadRows;
use crate::minibatch::{minibatches, split};
use crate::surrogate::sequential_factor;

/// Updates every agent in `order`; the factor `M` starts at 1 and takes in each updated agent's
/// ratio to its behaviour.
pub(super) fn sweep(
    agents: &mut [Agent],
    experience: &[Experience],
    influence: &[Influence],
    order: &[usize],
    (seed, iteration): (RunSeed, u64),
) -> Result<Report, MarlError> {
    let mut factor = vec![1.0; experience[0].log_prob.len()];
    let mut reports = vec![Report::new(); agents.len()];
    for (position, &index) in order.iter().enumerate() {
        let (agent, known) = (&mut agents[index], (&experience[index], &influence[index]));
        let draw = Draw::of(Purpose::Minibatch).iteration(iteration).agent(index as u32);
        let trained = maximise(agent, known, &factor, (seed, draw))?;
        let spread = mean_and_largest(&factor);
        reports[index] = report(agent, index, position, &trained, spread)?;
        let log_prob_new = log_prob(agent, known.0)?;
        factor = sequential_factor(&factor, &log_prob_new, &known.0.log_prob);
    }
    Ok(reports.concat())
}

/// What an agent's optimiser steps came to.
struct Trained {
    figures: Figures,
    gradient_norm: f64,
}

/// Epochs of minibatches of whole chunks up the objective of Eq. (10).
fn maximise(
    agent: &mut Agent,
    known: PerAgent<'_>,
    factor: &[f64],
    (seed, draw): (RunSeed, Draw),
) -> Result<Trained, MarlError> {
    let (epochs, parts) = (agent.update.epochs, agent.update.minibatches);
    let weight = 1.0 / (epochs * parts) as f64;
    let mut trained = Trained { figures: Figures::default(), gradient_norm: 0.0 };
    let mut influence = known.1.clone();
    for epoch in 0..epochs {
        let draw = draw.step(epoch as u32);
        for columns in minibatches(known.0.sequences.layout.chunks, parts, seed, draw) {
            agent.climb_posterior(known.0, &mut influence, &columns)?;
            let (figures, gradients) = gradient(agent, (known.0, &influence), factor, &columns)?;
            let norm = agent.adam.step(agent.network.parameters(), &gradients)?;
            agent.network.project()?;
            trained.figures.add(weight, &figures);
            trained.gradient_norm += weight * norm;
        }
    }
    Ok(trained)
}

/// The gradient of a minibatch: a fixed number of shards, each a graph of its own, added in their
/// order, so that the sum does not depend on how many threads computed it.
fn gradient(
    agent: &Agent,
    known: PerAgent<'_>,
    factor: &[f64],
    columns: &[usize],
) -> Result<(Figures, Gradients), MarlError> {
    let ranges = split(columns.len(), agent.update.shards);
    let shards = ranges
        .into_par_iter()
        .map(|range| shard(agent, known, factor, (&columns[range], columns.len())))
        .collect::<Result<Vec<_>, MarlError>>()?;
    let (mut figures, mut gradients) = (Figures::default(), Vec::with_capacity(shards.len()));
    for (own, gradient) in shards {
        figures.add(1.0, &own);
        gradients.push(gradient);
    }
    Ok((figures, Gradients::sum(gradients)))
}

fn shard(
    agent: &Agent,
    (experience, influence): PerAgent<'_>,
    factor: &[f64],
    (columns, total): (&[usize], usize),
) -> Result<(Figures, Gradients), MarlError> {
    let (sequences, layout) = (&experience.sequences, experience.sequences.layout);
    let features = agent.network.features(&sequences.input(columns, DType::F32)?)?;
    let head = agent.network.head(&features)?;
    let p = HeadRows::of(&head)?;
    let posterior = influence.conditional.as_ref().map(|q| q.posterior(layout, columns));
    let rows = Rows {
        action: layout.columns(&sequences.action, p.action_size(), columns),
        log_prob_old: layout.columns(&experience.log_prob, 1, columns),
        advantage: layout.columns(&experience.advantage, 1, columns),
        factor: layout.columns(factor, 1, columns),
        posterior: posterior.unwrap_or_default(),
    };
    let (figures, gradient) = p.loss(&rows, layout.steps * total, &agent.coefficients);
    Ok((figures, Gradients::of(agent.network.parameters(), &gradient.root(&head)?)?))
}

/// Log-densities of all actions under today's weights, `[L, C]`, computed shard by shard.
fn log_prob(agent: &Agent, experience: &Experience) -> Result<Vec<f64>, MarlError> {
    let layout = experience.sequences.layout;
    let parts = split(layout.chunks, agent.update.shards);
    let shards = parts
        .into_par_iter()
        .map(|range| {
            let columns: Vec<usize> = range.collect();
            Ok((agent.log_prob(&experience.sequences, &columns)?.0, columns))
        })
        .collect::<Result<Vec<_>, MarlError>>()?;
    let mut all = vec![0.0; layout.rows()];
    for (log_prob, columns) in shards {
        layout.scatter(&log_prob, &mut all, 1, &columns);
    }
    Ok(all)
}

fn report(
    agent: &Agent,
    index: usize,
    position: usize,
    trained: &Trained,
    (factor_mean, factor_largest): (f64, f64),
) -> Result<Report, MarlError> {
    let figures = &trained.figures;
    let named = [
        ("sweep_position", position as f64),
        ("policy_loss", figures.policy_loss),
        ("approx_kl", figures.approx_kl),
        ("clip_fraction", figures.clip_fraction),
        ("gradient_norm", trained.gradient_norm),
        ("skipped_steps", agent.adam.skipped() as f64),
        ("factor_mean", factor_mean),
        ("factor_largest", factor_largest),
        ("influence_kl", figures.influence),
        ("influence_capped", figures.capped_fraction),
    ];
    let named = named.into_iter().chain(spread(&agent.policy()?, figures));
    Ok(named.map(|(name, value)| (format!("agent{index}/{name}"), value)).collect())
}

/// How widely the policy draws: a Gaussian after the update, choices on average over it.
fn spread(policy: &ActorPolicy, figures: &Figures) -> Vec<(&'static str, f64)> {
    let sigma: Vec<f64> = policy.sigma().iter().map(|&s| f64::from(s)).collect();
    match policy.head() {
        Head::Gaussian => vec![
            ("entropy", gaussian::entropy(&sigma)),
            ("sigma", sigma.iter().sum::<f64>() / sigma.len() as f64),
        ],
        Head::Categorical { .. } => vec![("entropy", figures.entropy)],
    }
}

fn mean_and_largest(numbers: &[f64]) -> (f64, f64) {
    let mean = numbers.iter().sum::<f64>() / numbers.len() as f64;
    (mean, numbers.iter().fold(f64::NEG_INFINITY, |most, &x| most.max(x)))
}
