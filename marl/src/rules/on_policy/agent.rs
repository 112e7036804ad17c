//! One agent: its network, optimiser and posterior.

use std::ops::Range;
use std::sync::Arc;

use candle_core::{Device, Tensor};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorNetwork, ActorPolicy, PolicyConfig, SharedNoise};
use rayon::prelude::*;

use crate::config::{Estimator, QTraining, TrainingConfig, UpdateConfig};
use crate::data::batch::{ActionKind, Batch, Problem};
use crate::data::sequence::{ChunkLayout, Sequences};
use crate::distribution::HeadRows;
use crate::error::MarlError;
use crate::influence::mutual_information;
use crate::influence::posterior::{Posterior, PosteriorShape};
use crate::influence::second_head::SecondHead;
use crate::influence::whole_action::{policy_log_prob, posterior_log_prob};
use crate::objective::actor_loss::Coefficients;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::optimisation::shards::{self, shards};
use crate::rules::on_policy::counted;
use crate::rules::on_policy::experience::{Experience, Influence, mean};
use crate::state::{Visitor, visit_parameters};

/// A network in training. It has a posterior or a second head if the influence term has a weight, there are other
/// agents, and the estimator learns.
pub(crate) struct Agent {
    /// Agents that share parameters share the network.
    pub(crate) network: Arc<ActorNetwork>,
    pub(crate) adam: Adam,
    /// Parameters that `adam` updates: the network's and the second head's.
    pub(super) trainable: Arc<Parameters>,
    pub(crate) coefficients: Coefficients,
    pub(crate) update: UpdateConfig,
    pub(super) kind: ActionKind,
    pub(super) posterior: Option<Posterior>,
    pub(super) second_head: Option<SecondHead>,
    holdout_every: usize,
    /// Estimator of the influence term; `None` without one.
    estimator: Option<Estimator>,
    /// `None` if the agents' noise is independent.
    noise: Option<SharedNoise>,
    /// Steps between the others' actions that a posterior receives and the agent's own action.
    lag: usize,
    sigma_floor: f32,
}

impl Agent {
    pub(crate) fn new(
        config: &TrainingConfig,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
        index: usize,
    ) -> Result<Self, MarlError> {
        let shape = &problem.agents[index];
        let number = index as u32;
        let mut rng = generator(seed, Draw::of(Purpose::Initialisation).agent(number));
        let (observation, action) = (shape.observation, shape.action);
        let head = policy.with_noise(shape.kind.head());
        let network = ActorNetwork::new(policy, observation, action, head, &mut rng)?;
        let sizes = problem.agents.iter().map(|agent| agent.kind.encoded_size(agent.action));
        let total: usize = sizes.sum();
        let (update, influence) = (&config.update, &config.influence);
        let adam = update.adam();
        let own = PosteriorShape {
            others: total - shape.kind.encoded_size(shape.action),
            features: network.feature_size(),
            action: shape.action,
            kind: shape.kind,
        };
        let wanted = influence.lambda > 0.0 && own.others > 0;
        let estimator = wanted.then_some(influence.estimator);
        let learnt = estimator == Some(Estimator::VariationalKl);
        let q_adam = AdamConfig { learning_rate: influence.learning_rate, ..adam };
        let shared = influence.q_training == QTraining::Shared;
        let start_of_q = (seed, number);
        let posterior = (learnt && !shared)
            .then(|| Posterior::new(influence, q_adam, own, start_of_q))
            .transpose()?;
        let second_head = (learnt && shared)
            .then(|| SecondHead::new(influence, policy, own, start_of_q))
            .transpose()?;
        let none = Parameters::new();
        let second = second_head.as_ref().map_or(&none, SecondHead::parameters);
        let trainable = Arc::new(network.parameters().with("second_head.", second));
        Ok(Self {
            adam: Adam::new(adam, &trainable),
            trainable,
            network: Arc::new(network),
            coefficients: Coefficients {
                clip: update.clip,
                entropy: update.entropy,
                lambda: influence.lambda,
                kappa: influence.kappa,
            },
            update: update.clone(),
            kind: shape.kind,
            posterior,
            second_head,
            holdout_every: influence.holdout_every,
            estimator,
            noise: head.shared_noise(),
            lag: influence.lag,
            sigma_floor: policy.sigma_floor,
        })
    }

    pub(crate) fn hidden_size(&self) -> usize {
        self.network.hidden_size()
    }

    pub(crate) fn policy(&self) -> Result<ActorPolicy, MarlError> {
        Ok(self.network.policy()?)
    }

    /// Visits the network and its optimiser, under the name of their owner.
    pub(crate) fn visit_network(
        &mut self,
        owner: &str,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        visit_parameters(visitor, &format!("weights/{owner}."), self.network.parameters())?;
        self.adam.visit(&format!("optimizer/{owner}."), visitor)
    }

    /// Visits the posterior or the second head of agent `index`, if it has one.
    pub(crate) fn visit_posterior(
        &mut self,
        index: usize,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        if let Some(own) = &self.second_head {
            let prefix = format!("weights/second_head_{index}.");
            visit_parameters(visitor, &prefix, own.parameters())?;
        }
        self.posterior.as_mut().map_or(Ok(()), |own| own.visit(index, visitor))
    }

    /// Fraction of the dimensions of `sigma` at the floor.
    pub(crate) fn floored(&self, sigma: &[f32]) -> f64 {
        let lowest = self.sigma_floor * (1.0 + 1e-5);
        sigma.iter().filter(|&&sigma| sigma <= lowest).count() as f64 / sigma.len() as f64
    }

    /// The current weights' outputs for all rows, computed in shards: the policy, the log-probabilities of the actions
    /// given the signal, `[L, C]`, and the features, `[L * C, F]`.
    pub(super) fn evaluate(
        &self,
        sequences: &Sequences,
    ) -> Result<(HeadRows, Vec<f64>, Tensor), MarlError> {
        let layout = sequences.layout;
        let weights = self.network.weights()?;
        let parts = shards(layout.chunks, layout.steps);
        let one = |range: Range<usize>| {
            let columns: Vec<usize> = range.collect();
            let input = sequences.input(&columns)?;
            let (head, features) = self.network.distribution_and_features(&weights, &input)?;
            Ok((HeadRows::of(&head)?, features))
        };
        let (heads, features): (Vec<_>, Vec<_>) = shards::of_each(&parts, one)?.into_iter().unzip();
        let rows = HeadRows::gathered(&heads, layout, &parts);
        let width = rows.action_size();
        let actions = sequences.action.chunks_exact(width).enumerate();
        let given = rows.given(&sequences.signal);
        let log_prob = actions.map(|(row, action)| given.log_prob_of(row, action)).collect();
        drop(given);
        let order = Tensor::from_vec(layout.order(&parts), layout.rows(), &Device::Cpu)?;
        Ok((rows, log_prob, Tensor::cat(&features, 0)?.index_select(&order, 0)?))
    }

    /// Trains the posterior by maximum likelihood, before the sweep, on all environments except the held-out ones, and
    /// evaluates it on every row. A second head is only evaluated. It has not been trained on this `D_k` yet, so all
    /// rows measure the estimate.
    fn fit_posterior(
        &mut self,
        experience: &Experience,
        (seed, draw): (RunSeed, Draw),
    ) -> Result<Influence, MarlError> {
        if let Some(samples) = &experience.samples {
            return Ok(counted::influence(samples, self.kind, experience));
        }
        let layout = experience.sequences.layout;
        let last = self.holdout_every - 1;
        let held_out =
            |row: &usize| layout.environment(row % layout.chunks) % self.holdout_every == last;
        let all: Vec<usize> = (0..layout.rows()).collect();
        let action = &experience.sequences.action;
        let data = experience.conditions();
        let (conditional, [holdout, trained], fitted, skipped) =
            match (&mut self.posterior, &self.second_head) {
                (Some(posterior), _) => {
                    let (holdout, trained): (Vec<usize>, Vec<usize>) =
                        all.iter().copied().partition(held_out);
                    let likelihood = posterior.fit(&data, &trained, &holdout, (seed, draw))?;
                    (
                        posterior.conditional(&data, &all)?,
                        [holdout, trained],
                        Some(likelihood),
                        posterior.skipped(),
                    )
                }
                (None, Some(second)) => (second.conditional(&data)?, [all.clone(), all], None, 0),
                (None, None) => return Ok(Influence::default()),
            };
        let found = || mean(&conditional.log_prob(action, &holdout));
        let log_likelihood = fitted.unwrap_or_else(found);
        let behaviour = &experience.behaviour;
        let (log_p, log_q) = if behaviour.loading.is_empty() || behaviour.action_size() == 1 {
            (behaviour.log_prob(action, &holdout), conditional.log_prob(action, &holdout))
        } else {
            (
                policy_log_prob(behaviour, action, &holdout),
                posterior_log_prob(&conditional, action, &trained, &holdout),
            )
        };
        let mi_estimate = mutual_information(&log_q, &log_p);
        let held_out = mi_estimate.map(|_| (-mean(&log_q), -mean(&log_p)));
        let divergence = mean(&conditional.kl_divergences(behaviour));
        Ok(Influence {
            conditional: Some(conditional),
            others_precision: None,
            log_likelihood,
            mi_estimate,
            held_out,
            divergence,
            skipped,
        })
    }
}

/// Every agent's rollout data with the outputs of the behaviour weights, which are the networks' current ones.
pub(crate) fn gather(
    agents: &[Agent],
    batch: &Batch,
    layout: ChunkLayout,
    advantages: &[Vec<f64>],
    key: (RunSeed, u64),
) -> Result<Vec<Experience>, MarlError> {
    let signal = shared_signal(agents[0].noise, batch, layout, key);
    let one = |index: usize| {
        let agent = &agents[index];
        let mut sequences = Sequences::of(batch, index, layout, agent.hidden_size());
        sequences.signal.clone_from(&signal);
        let (behaviour, log_prob, features) = agent.evaluate(&sequences)?;
        let others = other_actions(agents, batch, index, layout);
        let samples = (agent.estimator == Some(Estimator::Count))
            .then(|| counted::samples(&sequences, &others));
        Ok(Experience {
            sequences,
            advantage: layout.chunked(&advantages[index], 1),
            log_prob,
            behaviour,
            features,
            others,
            samples,
        })
    };
    (0..agents.len()).into_par_iter().map(one).collect()
}

/// The signal that all agents shared in every row of the iteration's data, `[L, C, K]`; empty with independent noise.
fn shared_signal(
    noise: Option<SharedNoise>,
    batch: &Batch,
    layout: ChunkLayout,
    (seed, iteration): (RunSeed, u64),
) -> Vec<f64> {
    let Some(noise) = noise else { return Vec::new() };
    let of_row = |row: usize| {
        let (step, environment) = (row / batch.environments, row % batch.environments);
        noise.signal(seed, Draw::of_action(iteration, environment as u32, step as u32, 0))
    };
    let rows = (0..batch.rows()).flat_map(of_row).map(f64::from);
    layout.chunked(&rows.collect::<Vec<f64>>(), noise.size)
}

/// Encoded actions of all agents but `agent`, joined in agent order, `[L, C, others]`: those of the same step, or with
/// a lag of 1 those of the previous step. They are zeros at an episode's first step and at the first step of `D_k`.
fn other_actions(agents: &[Agent], batch: &Batch, agent: usize, layout: ChunkLayout) -> Vec<f32> {
    let rows = batch.rows();
    let others: Vec<(ActionKind, &[f32])> = (0..agents.len())
        .filter(|&index| index != agent)
        .map(|index| (agents[index].kind, batch.agents[index].action.as_slice()))
        .collect();
    let mut encoded = Vec::new();
    for row in 0..rows {
        let source = earlier(batch, row, agents[agent].lag);
        for (kind, actions) in &others {
            let width = actions.len() / rows;
            match source {
                Some(row) => kind.encode(&actions[row * width..(row + 1) * width], &mut encoded),
                None => encoded.resize(encoded.len() + kind.encoded_size(width), 0.0),
            }
        }
    }
    let width = encoded.len() / rows;
    layout.chunked(&encoded, width)
}

/// The row `lag` steps (0 or 1) before row `t * B + b` of the same episode, if `D_k` contains it.
fn earlier(batch: &Batch, row: usize, lag: usize) -> Option<usize> {
    let before = row.checked_sub(lag * batch.environments)?;
    (lag == 0 || !batch.done(before)).then_some(before)
}

/// Posteriors of all agents, or their exact information, computed in parallel.
pub(crate) fn fit_posteriors(
    agents: &mut [Agent],
    experience: &[Experience],
    seed: RunSeed,
    iteration: u64,
) -> Result<Vec<Influence>, MarlError> {
    let one = |(index, (agent, own)): (usize, (&mut Agent, &Experience))| {
        if agent.estimator == Some(Estimator::Exact) {
            return Ok(Influence::exact(index, experience));
        }
        let draw = Draw::of(Purpose::PosteriorMinibatch).iteration(iteration).agent(index as u32);
        agent.fit_posterior(own, (seed, draw))
    };
    agents.par_iter_mut().zip(experience).enumerate().map(one).collect()
}
