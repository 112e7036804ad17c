//! Acting with all agents in a batch of environments: observations in, joint actions out.

use policy::{Draw, PolicySnapshot, Purpose, RunSeed, Scratch, generator};
use proto::ActionChoice;
use sim::{EnvironmentBatch, Outcome};

use crate::step_event::PlayedStep;

/// Buffers of a slot's agents for `E` environments; rows are in the order of the environments.
#[derive(Debug, Default)]
pub(crate) struct Agents {
    environments: usize,
    sizes: Vec<Sizes>,
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
    /// Joint actions, `[E, A]`, in agent order.
    pub(crate) joint: Vec<f32>,
    scratch: Scratch,
}

#[derive(Clone, Copy, Debug)]
struct Sizes {
    observation: usize,
    output: usize,
    action: usize,
    hidden: usize,
}

/// Parts of the key of a step's draws.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Noise {
    pub(crate) seed: RunSeed,
    pub(crate) iteration: u64,
    pub(crate) step: u32,
}

impl Agents {
    /// Allocates buffers for `policy` and these environments, with zero recurrent states.
    pub(crate) fn new(environments: &dyn EnvironmentBatch, policy: &PolicySnapshot) -> Self {
        let count = environments.count();
        let sizes: Vec<Sizes> = policy
            .agents
            .iter()
            .map(|agent| Sizes {
                observation: agent.observation_size(),
                output: agent.output_size(),
                action: agent.action_size(),
                hidden: agent.hidden_size(),
            })
            .collect();
        let rows = |width: fn(&Sizes) -> usize| {
            sizes.iter().map(|size| vec![0.0; count * width(size)]).collect::<Vec<_>>()
        };
        Self {
            environments: count,
            observation: rows(|size| size.observation),
            hidden: rows(|size| size.hidden),
            output: rows(|size| size.output),
            action: rows(|size| size.action),
            log_prob: rows(|_| 1),
            joint: vec![0.0; count * sizes.iter().map(|size| size.action).sum::<usize>()],
            scratch: Scratch::default(),
            sizes,
        }
    }

    /// Reads every agent's observation of every environment.
    pub(crate) fn observe(&mut self, environments: &dyn EnvironmentBatch) {
        for (agent, (rows, size)) in self.observation.iter_mut().zip(&self.sizes).enumerate() {
            for (environment, row) in rows.chunks_exact_mut(size.observation).enumerate() {
                environments.observation(environment, agent, row);
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
    pub(crate) fn draw(&mut self, policy: &PolicySnapshot, indices: &[u32], noise: Noise) {
        for (agent, policy) in policy.agents.iter().enumerate() {
            let Sizes { action: width, output, .. } = self.sizes[agent];
            for (row, &environment) in indices.iter().enumerate() {
                let key = Draw::of_action(noise.iteration, environment, noise.step, agent as u32);
                let mut rng = generator(noise.seed, key);
                let output = &self.output[agent][row * output..(row + 1) * output];
                let action = &mut self.action[agent][row * width..(row + 1) * width];
                policy.draw(output, &mut rng, action);
                self.log_prob[agent][row] = policy.log_prob(output, action);
            }
        }
    }

    /// Selects the actions of step `step` by `choice`. Sampled actions are equal to those of a served policy with the
    /// same seed in its first episode.
    pub(crate) fn choose(&mut self, policy: &PolicySnapshot, choice: ActionChoice, step: u32) {
        let ActionChoice::Sampled { seed } = choice else { return self.select_modes(policy) };
        for (agent, policy) in policy.agents.iter().enumerate() {
            let key = Draw::of(Purpose::ServedAction).step(step).agent(agent as u32);
            let mut rng = generator(RunSeed(seed), key);
            policy.draw(&self.output[agent], &mut rng, &mut self.action[agent]);
        }
    }

    /// Sets the actions to the means or the most likely choices.
    fn select_modes(&mut self, policy: &PolicySnapshot) {
        for (agent, policy) in policy.agents.iter().enumerate() {
            let Sizes { action: width, output, .. } = self.sizes[agent];
            let outputs = self.output[agent].chunks_exact(output);
            for (action, output) in self.action[agent].chunks_exact_mut(width).zip(outputs) {
                policy.mode(output, action);
            }
        }
    }

    /// Builds the joint actions, `[E, A]`.
    pub(crate) fn join(&mut self) -> &[f32] {
        let total = self.joint.len() / self.environments;
        let mut first = 0;
        for (agent, size) in self.sizes.iter().enumerate() {
            for (row, action) in self.action[agent].chunks_exact(size.action).enumerate() {
                let from = row * total + first;
                self.joint[from..from + size.action].copy_from_slice(action);
            }
            first += size.action;
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
            outcomes,
        }
    }

    /// Sets the recurrent states of an environment to zero.
    pub(crate) fn reset_hidden(&mut self, environment: usize) {
        for (hidden, size) in self.hidden.iter_mut().zip(&self.sizes) {
            hidden[environment * size.hidden..(environment + 1) * size.hidden].fill(0.0);
        }
    }

    /// Sets the recurrent states of an environment, `[H]` for each agent.
    pub(crate) fn set_hidden(&mut self, environment: usize, recurrent: &[Vec<f32>]) {
        for ((hidden, size), own) in self.hidden.iter_mut().zip(&self.sizes).zip(recurrent) {
            hidden[environment * size.hidden..(environment + 1) * size.hidden].copy_from_slice(own);
        }
    }
}
