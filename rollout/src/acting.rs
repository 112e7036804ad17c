//! Acting with all agents in a batch of environments: observations in, joint actions out.

use std::ops::Range;

use policy::{ActorPolicy, Draw, PolicySnapshot, RunSeed, Scratch, generator};
use proto::ActionChoice;
use sim::{EnvironmentBatch, Outcome};

use crate::step_event::PlayedStep;

/// Buffers of a slot's agents for `E` environments; rows are in the order of the environments.
#[derive(Debug, Default)]
pub(crate) struct Agents {
    environments: usize,
    /// Observations of each agent, `[E, obs]`.
    pub(crate) observation: Vec<Vec<f32>>,
    /// Recurrent states of each agent, `[E, H]`.
    pub(crate) hidden: Vec<Vec<f32>>,
    /// Network outputs of each agent, `[E, out]`: means, or logits of choices.
    pub(crate) output: Vec<Vec<f32>>,
    /// Actions of each agent, `[E, act]`.
    pub(crate) action: Vec<Vec<f32>>,
    /// Log-probabilities of each agent, `[E]`.
    pub(crate) log_prob: Vec<Vec<f32>>,
    /// Signals that all agents share, `[E, K]`; empty if they share none.
    signal: Vec<f32>,
    /// Joint actions, `[E, A]`, in agent order.
    pub(crate) joint: Vec<f32>,
    scratch: Scratch,
}

/// Parts of the key of a step's draws.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrawContext {
    pub(crate) seed: RunSeed,
    pub(crate) iteration: u64,
    pub(crate) step: u32,
}

impl Agents {
    /// Allocates buffers for `policy` and these environments, with zero recurrent states.
    pub(crate) fn new(environments: &dyn EnvironmentBatch, policy: &PolicySnapshot) -> Self {
        let count = environments.count();
        let rows = |width: fn(&ActorPolicy) -> usize| -> Vec<Vec<f32>> {
            policy.agents.iter().map(|agent| vec![0.0; count * width(agent)]).collect()
        };
        let action = rows(ActorPolicy::action_size);
        Self {
            environments: count,
            observation: rows(ActorPolicy::observation_size),
            hidden: rows(ActorPolicy::hidden_size),
            output: rows(ActorPolicy::output_size),
            log_prob: rows(|_| 1),
            signal: Vec::new(),
            joint: action.concat(),
            action,
            scratch: Scratch::default(),
        }
    }

    /// Reads every agent's observation of every environment.
    pub(crate) fn observe(&mut self, environments: &dyn EnvironmentBatch) {
        for (agent, rows) in self.observation.iter_mut().enumerate() {
            for environment in 0..self.environments {
                let of_row = row(rows.len(), environment, self.environments);
                environments.observation(environment, agent, &mut rows[of_row]);
            }
        }
    }

    /// Evaluates every agent's network and advances the recurrent states.
    pub(crate) fn forward(&mut self, policy: &PolicySnapshot) {
        for (agent, policy) in policy.agents.iter().enumerate() {
            let (hidden, output) = (&mut self.hidden[agent], &mut self.output[agent]);
            let observation = &self.observation[agent];
            policy.forward(self.environments, observation, hidden, output, &mut self.scratch);
        }
    }

    /// Samples actions from the networks' distributions and computes their log-probabilities. Each draw has its own
    /// key. `indices` are the global indices of the environments, in the order of the rows.
    pub(crate) fn draw(&mut self, policy: &PolicySnapshot, indices: &[u32], context: DrawContext) {
        let DrawContext { seed, iteration, step } = context;
        let key = |environment: u32, agent: usize| {
            Draw::of_action(iteration, environment, step, agent as u32)
        };
        self.signal.clear();
        for &environment in indices {
            self.signal.extend(policy.signal(seed, key(environment, 0)));
        }
        for (agent, policy) in policy.agents.iter().enumerate() {
            let output = &mut self.output[agent];
            let action = &mut self.action[agent];
            for (place, &environment) in indices.iter().enumerate() {
                let key = key(environment, agent);
                let mut rng = generator(seed, key);
                let own = row(output.len(), place, self.environments);
                let output = &mut output[own];
                let of_row = row(action.len(), place, self.environments);
                policy.add_shared_noise(seed, key, output);
                policy.draw(output, &mut rng, &mut action[of_row.clone()]);
                self.log_prob[agent][place] = policy.log_prob(output, &action[of_row]);
            }
        }
    }

    /// Selects the actions of step `step` by `choice`. Sampled actions are equal to those of a served policy with the
    /// same seed in its first episode.
    pub(crate) fn choose(&mut self, policy: &PolicySnapshot, choice: ActionChoice, step: u32) {
        let ActionChoice::Sampled { seed } = choice else { return self.select_modes(policy) };
        self.signal = policy.signal(RunSeed(seed), Draw::of_served_action((0, 0), step, 0));
        for (agent, policy) in policy.agents.iter().enumerate() {
            let key = Draw::of_served_action((0, 0), step, agent as u32);
            let output = &mut self.output[agent];
            policy.add_shared_noise(RunSeed(seed), key, output);
            policy.draw(output, &mut generator(RunSeed(seed), key), &mut self.action[agent]);
        }
    }

    /// Sets the actions to the means or the most likely choices.
    fn select_modes(&mut self, policy: &PolicySnapshot) {
        for (agent, policy) in policy.agents.iter().enumerate() {
            let output = &self.output[agent];
            let action = &mut self.action[agent];
            for place in 0..self.environments {
                let output = &output[row(output.len(), place, self.environments)];
                let of_row = row(action.len(), place, self.environments);
                policy.mode(output, &mut action[of_row]);
            }
        }
    }

    /// Builds the joint actions, `[E, A]`.
    pub(crate) fn join(&mut self) -> &[f32] {
        self.joint.clear();
        for place in 0..self.environments {
            for action in &self.action {
                let of_row = row(action.len(), place, self.environments);
                self.joint.extend_from_slice(&action[of_row]);
            }
        }
        &self.joint
    }

    /// Step number `step` of these agents, for observers, without log-probabilities.
    pub(crate) fn played<'a>(
        &'a self,
        world: &'a dyn EnvironmentBatch,
        outcomes: &'a [Outcome],
        step: u32,
    ) -> PlayedStep<'a> {
        PlayedStep {
            world,
            step,
            observation: &self.observation,
            hidden: &self.hidden,
            actions: &self.action,
            log_probs: None,
            signal: &self.signal,
            outcomes,
        }
    }

    /// Sets the recurrent states of an environment to zero.
    pub(crate) fn reset_hidden(&mut self, environment: usize) {
        for hidden in &mut self.hidden {
            let of_row = row(hidden.len(), environment, self.environments);
            hidden[of_row].fill(0.0);
        }
    }

    /// Sets the recurrent states of an environment, `[H]` for each agent.
    pub(crate) fn set_hidden(&mut self, environment: usize, recurrent: &[Vec<f32>]) {
        for (hidden, own) in self.hidden.iter_mut().zip(recurrent) {
            let of_row = row(hidden.len(), environment, self.environments);
            hidden[of_row].copy_from_slice(own);
        }
    }
}

/// Row `index` of `count` rows of `all` numbers together.
fn row(all: usize, index: usize, count: usize) -> Range<usize> {
    let width = all / count;
    index * width..(index + 1) * width
}
