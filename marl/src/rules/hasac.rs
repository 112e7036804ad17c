//! HASAC: heterogeneous-agent soft actor-critic (Liu et al., ICLR 2024) with batch norm and without target networks, as
//! CrossQ (Bhatt et al., ICLR 2024).
//!
//! Twin critics value joint actions. Agents are updated one after the other in random order, each against the newest
//! actions of those before it.

mod actions;
mod agent;
mod columns;
mod critics;
mod loadings;
mod network;

use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use policy::{PolicyConfig, PolicySnapshot};
use rand::RngCore;
use rayon::prelude::*;

use crate::config::TrainingConfig;
use crate::data::batch::{Batch, Problem};
use crate::error::MarlError;
use crate::influence::exact::{exact_information, others_precision};
use crate::optimisation::minibatch::permutation;
use crate::rules::algorithm::{Algorithm, PREFIXES, Report};
use crate::rules::hasac::actions::DrawnActions;
use crate::rules::hasac::agent::{HasacAgent, PolicyMetrics};
use crate::rules::hasac::critics::{CriticMetrics, TwinCritics};
use crate::rules::hasac::loadings::Loadings;
use crate::rules::off_policy::ReplayedExperience;
use crate::rules::off_policy::replay::Sample;
use crate::state::{StoredState, Visitor, visit_count};
use crate::surprise::{Relabelled, Surprise};

/// HASAC with twin critics.
pub(crate) struct Hasac {
    policy_every: u64,
    seed: RunSeed,
    agents: Vec<HasacAgent>,
    critics: TwinCritics,
    experience: ReplayedExperience,
    /// Optimiser steps of the critics so far.
    steps: i64,
}

/// Sums of metrics over the optimiser steps of an iteration.
struct Sums {
    critics: CriticMetrics,
    policy_steps: u64,
    policies: Vec<PolicyMetrics>,
}

impl Hasac {
    /// Networks for `problem`, with weights initialised by `seed`, and an empty replay.
    ///
    /// # Errors
    /// If the section `hasac` is missing; if a tensor operation fails.
    pub(crate) fn new(
        config: &TrainingConfig,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let (Some(own), Some(replay)) = (&config.hasac, config.replay()) else {
            return Err(MarlError::Batch("update.rule = hasac needs the section hasac".to_owned()));
        };
        let agent = |index| HasacAgent::new((config, own), policy, problem, seed, index);
        Ok(Self {
            policy_every: own.policy_every,
            seed,
            agents: (0..problem.agents.len()).map(agent).collect::<Result<_, _>>()?,
            critics: TwinCritics::new((config, own), problem, seed)?,
            experience: ReplayedExperience::new(replay, config, problem, seed),
            steps: 0,
        })
    }

    /// One optimiser step of the critics, and one of every policy if it is due.
    fn learn(
        &mut self,
        (iteration, step): (u64, u32),
        surprise: Option<&Surprise>,
        sums: &mut Sums,
    ) -> Result<(), MarlError> {
        let mut sample = self.experience.sample((iteration, step), surprise)?;
        self.critics.scale(&mut sample.now.state);
        self.critics.scale(&mut sample.next.state);
        let draw = Draw::of(Purpose::UpdateAction).iteration(iteration).step(step);
        let noise = |agent: usize| generator(self.seed, draw.agent(agent as u32));
        let mut noise: Vec<_> = (0..self.agents.len()).map(noise).collect();
        let [next_signal, signal] = self.signals((iteration, step), sample.discount.len());
        let figures = self.fit_critics(&sample, &next_signal, &mut noise)?;
        sums.critics.value_loss += figures.value_loss;
        sums.critics.gradient_norm += figures.gradient_norm;
        if (self.steps as u64).is_multiple_of(self.policy_every) {
            let order = Draw::of(Purpose::AgentOrder).iteration(iteration).step(step);
            let order = permutation(self.agents.len(), &mut generator(self.seed, order));
            let figures = self.improve_policies(&sample, &order, &signal, &mut noise)?;
            sums.policy_steps += 1;
            for (sum, figures) in sums.policies.iter_mut().zip(figures) {
                sum.policy_loss += figures.policy_loss;
                sum.action_value += figures.action_value;
                sum.entropy += figures.entropy;
                sum.gradient_norm += figures.gradient_norm;
                sum.information += figures.information;
            }
        }
        self.steps += 1;
        Ok(())
    }

    /// The signals that agents share in the next and the current states of `rows` transitions, `[R, K]` each; empty unless the
    /// loadings are learnt. Constant loadings correlate acting only.
    fn signals(&self, (iteration, step): (u64, u32), rows: usize) -> [Vec<f32>; 2] {
        let size = self.agents[0].loadings().map_or(0, Loadings::signal_size);
        let draw = Draw::of(Purpose::UpdateSignal).iteration(iteration).step(step);
        let mut rng = generator(self.seed, draw);
        [(); 2].map(|()| (0..rows * size).map(|_| standard_normal(&mut rng)).collect())
    }

    /// Actions of all agents for their observations `[N][R, obs]` and the signal that they share `[R, K]`.
    fn act<R: RngCore + Send>(
        &mut self,
        observation: &[Vec<f32>],
        signal: &[f32],
        noise: &mut [R],
    ) -> Result<Vec<DrawnActions>, MarlError> {
        let inputs = observation.par_iter().zip(noise);
        let agents = self.agents.par_iter_mut().zip(inputs);
        agents.map(|(agent, (observation, noise))| agent.act(observation, signal, noise)).collect()
    }

    /// One step of the critics towards
    /// `sum_k gamma^k r_(t+k) + gamma^m (min_j Q_j(s', a') - sum_i temperature_i log pi_i(a'_i|o'_i))`, where `r` is the mean
    /// of the agents' rewards.
    fn fit_critics<R: RngCore + Send>(
        &mut self,
        sample: &Sample,
        signal: &[f32],
        noise: &mut [R],
    ) -> Result<CriticMetrics, MarlError> {
        let next = self.act(&sample.next.observation, signal, noise)?;
        let temperatures = self.agents.iter().map(HasacAgent::temperature);
        let temperatures = temperatures.collect::<Result<Vec<_>, _>>()?;
        let taken: Vec<&[f32]> = sample.action.iter().map(Vec::as_slice).collect();
        let following: Vec<&[f32]> = next.iter().map(|drawn| drawn.action.as_slice()).collect();
        let mut input = self.critics.joint_input(&sample.now.state, &taken);
        input.extend(self.critics.joint_input(&sample.next.state, &following));
        self.critics.fit(&input, |values| targets(sample, values, &next, &temperatures))
    }

    /// One step of every policy in `order`, against the newest actions of those before it and the current actions of the
    /// others.
    fn improve_policies<R: RngCore + Send>(
        &mut self,
        sample: &Sample,
        order: &[usize],
        signal: &[f32],
        noise: &mut [R],
    ) -> Result<Vec<PolicyMetrics>, MarlError> {
        let mut critics = self.critics.frozen()?;
        let drawn = self.act(&sample.now.observation, signal, noise)?;
        let mut actions: Vec<Vec<f32>> = drawn.into_iter().map(|drawn| drawn.action).collect();
        let mut figures = vec![PolicyMetrics::default(); self.agents.len()];
        for &index in order {
            let observation = &sample.now.observation[index];
            let drawn =
                self.agents[index].act_in_training(observation, signal, &mut noise[index])?;
            actions[index].clone_from(&drawn.action);
            let joint: Vec<&[f32]> = actions.iter().map(Vec::as_slice).collect();
            let input = self.critics.joint_input(&sample.now.state, &joint);
            let (values, by_input) = critics.smaller(&input);
            let by_action = self.columns_of(index, &by_input);
            let others = self.others_precision(index)?;
            let agent = &mut self.agents[index];
            figures[index] = agent.improve(&drawn, (&values, &by_action), (signal, &others))?;
            actions[index] = agent.act(observation, signal, &mut noise[index])?.action;
        }
        Ok(figures)
    }

    /// The precision that the current actions of all agents but `index` add to the signal's, `[K, K]`; empty unless the loadings are
    /// learnt.
    fn others_precision(&self, index: usize) -> Result<Vec<f64>, MarlError> {
        let loadings = self.agents.iter().filter_map(HasacAgent::loadings);
        let Some(size) = loadings.clone().next().map(Loadings::signal_size) else {
            return Ok(Vec::new());
        };
        let loadings = loadings.map(Loadings::values).collect::<Result<Vec<_>, _>>()?;
        let loadings: Vec<&[f64]> = loadings.iter().map(Vec::as_slice).collect();
        Ok(others_precision(index, &loadings, size))
    }

    /// Information between the actions of agent `index` and those of all others, nats; `None` unless it has a weight.
    fn information(&self, index: usize) -> Result<Option<f64>, MarlError> {
        let weighted = |loadings: &&Loadings| loadings.lambda() > 0.0;
        let Some(own) = self.agents[index].loadings().filter(weighted) else { return Ok(None) };
        let others = self.others_precision(index)?;
        Ok(Some(exact_information(&own.values()?, &others, own.signal_size()).0))
    }

    /// The columns of the joint input `[R, S + A]` that are actions of agent `index`, `[R, act]`.
    fn columns_of(&self, index: usize, input: &[f32]) -> Vec<f32> {
        let after: usize = self.agents[index + 1..].iter().map(HasacAgent::actions).sum();
        let width = self.critics.inputs();
        let columns = width - after - self.agents[index].actions()..width - after;
        input.chunks_exact(width).flat_map(|row| &row[columns.clone()]).copied().collect()
    }

    /// Metrics of an iteration's `updates`. `known` is the agents' information before them.
    fn report(
        &self,
        updates: u64,
        sums: &Sums,
        known: &[Option<f64>],
    ) -> Result<Report, MarlError> {
        let mut report = self.experience.report(updates);
        if updates == 0 {
            return Ok(report);
        }
        let share = 1.0 / updates as f64;
        for (name, value) in [
            ("value_loss", share * sums.critics.value_loss),
            ("value_gradient_norm", share * sums.critics.gradient_norm),
            ("value_skipped_steps", self.critics.skipped() as f64),
        ] {
            report.push((format!("losses/{name}"), value));
        }
        let share = 1.0 / sums.policy_steps as f64;
        let mean = |sum: f64| (sums.policy_steps > 0).then_some(share * sum);
        for (index, (agent, sum)) in self.agents.iter().zip(&sums.policies).enumerate() {
            for (name, value) in [
                ("policy_loss", mean(sum.policy_loss)),
                ("action_value", mean(sum.action_value)),
                ("entropy", mean(sum.entropy)),
                ("temperature", Some(agent.temperature()?)),
                ("gradient_norm", mean(sum.gradient_norm)),
                ("skipped_steps", Some(agent.skipped() as f64)),
                ("noise_loading", agent.policy()?.mean_loading()),
                ("influence_kl", known[index].and_then(|_| mean(sum.information))),
                ("mi_estimate", known[index]),
            ] {
                report.extend(value.map(|value| (format!("agent{index}/{name}"), value)));
            }
        }
        Ok(report)
    }
}

/// The critics' targets, `[R]`, from their values in the next states, `[2][R]`.
fn targets(
    sample: &Sample,
    values: [&[f32]; 2],
    next: &[DrawnActions],
    temperatures: &[f64],
) -> Vec<f64> {
    let target = |row: usize| {
        let [first, second] = values.map(|values| f64::from(values[row]));
        let agents = next.iter().zip(temperatures);
        let bonus: f64 = agents.map(|(drawn, weight)| weight * drawn.log_prob[row]).sum();
        let value = if first <= second { first } else { second } - bonus;
        // A termination has no next value, whatever value the critics give the state after it.
        let next = if sample.discount[row] == 0.0 { 0.0 } else { sample.discount[row] * value };
        team_reward(sample, row) + next
    };
    (0..sample.discount.len()).map(target).collect()
}

/// Mean of the agents' rewards, which is exact if they are equal.
fn team_reward(sample: &Sample, row: usize) -> f64 {
    let first = sample.reward[0][row];
    let others: f64 = sample.reward.iter().map(|own| own[row] - first).sum();
    first + others / sample.reward.len() as f64
}

impl Algorithm for Hasac {
    fn scale_learning_rates(&mut self, share: f64) {
        self.critics.scale_learning_rates(share);
        self.agents.iter_mut().for_each(|agent| agent.scale_learning_rates(share));
    }

    fn scale_noise(&mut self, share: f64) {
        self.agents.iter_mut().for_each(|agent| agent.scale_noise(share as f32));
    }

    fn begin_again(&mut self, environment: usize) {
        self.experience.begin_again(environment);
    }

    fn update(
        &mut self,
        batch: &Batch,
        rewards: &Relabelled<'_>,
        iteration: u64,
    ) -> Result<Report, MarlError> {
        let updates = self.experience.add(batch, rewards)?;
        let mut sums = Sums {
            critics: CriticMetrics::default(),
            policy_steps: 0,
            policies: vec![PolicyMetrics::default(); self.agents.len()],
        };
        let known = (0..self.agents.len()).map(|index| self.information(index));
        let known = known.collect::<Result<Vec<_>, _>>()?;
        for step in 0..updates {
            self.learn((iteration, step as u32), rewards.surprise, &mut sums)?;
        }
        self.report(updates, &sums, &known)
    }

    fn snapshot(&self) -> Result<PolicySnapshot, MarlError> {
        let agents = self.agents.iter().map(HasacAgent::policy);
        Ok(self.experience.snapshot(agents.collect::<Result<_, _>>()?))
    }
}

impl StoredState for Hasac {
    fn prefixes(&self) -> &'static [&'static str] {
        &PREFIXES
    }

    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.agents.iter_mut().try_for_each(|agent| agent.visit(visitor))?;
        self.critics.visit(visitor)?;
        visit_count(visitor, "optimizer/steps", &mut self.steps)?;
        self.experience.visit(visitor)
    }
}

#[cfg(test)]
mod tests;
