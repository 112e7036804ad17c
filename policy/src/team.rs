//! A trained team in environments that another program steps: recurrent states and random draws.

use crate::acting::Scratch;
use crate::randomness::{Draw, RunSeed, generator};
use crate::snapshot::PolicySnapshot;

/// All agents of `E` environments.
#[derive(Clone, Debug)]
pub struct Team {
    /// Seed of sampled actions; without it, actions are means or likeliest choices.
    seed: Option<RunSeed>,
    /// Episodes before the current one, of each environment.
    episodes: Vec<u64>,
    members: Vec<Member>,
    output: Vec<f32>,
    scratch: Scratch,
}

/// The states of one agent in the current episodes.
#[derive(Clone, Debug)]
struct Member {
    /// `[E, H]`
    hidden: Vec<f32>,
    /// Finished steps of the episodes, `[E]`.
    steps: Vec<u32>,
}

impl Team {
    /// Agents at the start of their first episodes. Sampled actions follow from `seed`.
    #[must_use]
    pub fn new(policy: &PolicySnapshot, environments: usize, seed: Option<RunSeed>) -> Self {
        let members = policy.agents.iter().map(|agent| Member {
            hidden: vec![0.0; environments * agent.hidden_size()],
            steps: vec![0; environments],
        });
        let members = members.collect();
        let episodes = vec![0; environments];
        Self { seed, episodes, members, output: Vec::new(), scratch: Scratch::default() }
    }

    /// Number of environments `E`.
    #[must_use]
    pub fn environments(&self) -> usize {
        self.episodes.len()
    }

    /// Starts an episode of an environment: its recurrent states become zero. An episode without a step is not counted.
    pub fn reset(&mut self, environment: usize) {
        let begun = self.members.iter().any(|member| member.steps[environment] > 0);
        self.episodes[environment] += u64::from(begun);
        for Member { hidden, steps } in &mut self.members {
            let width = hidden.len() / steps.len();
            hidden[environment * width..][..width].fill(0.0);
            steps[environment] = 0;
        }
    }

    /// Computes an agent's actions `[E, act]` from its observations `[E, obs]` and advances its recurrent states. Rows are
    /// computed separately, so an action depends on no other row. `policy` has the sizes of that in [`Self::new`].
    pub fn act(&mut self, policy: &PolicySnapshot, agent: usize, observations: &[f32]) -> Vec<f32> {
        let Member { hidden, steps } = &mut self.members[agent];
        let (policy, rows) = (&policy.agents[agent], steps.len());
        let (outputs, size) = (policy.output_size(), policy.action_size());
        self.output.resize(rows * outputs, 0.0);
        policy.forward(rows, observations, hidden, &mut self.output, &mut self.scratch);
        let mut actions = vec![0.0; rows * size];
        for (environment, step) in steps.iter_mut().enumerate() {
            let output = &mut self.output[environment * outputs..][..outputs];
            let action = &mut actions[environment * size..][..size];
            match self.seed {
                None => policy.mode(output, action),
                Some(seed) => {
                    let place = (self.episodes[environment], environment as u32);
                    let key = Draw::of_served_action(place, *step, agent as u32);
                    policy.add_shared_noise(seed, key, output);
                    policy.draw(output, &mut generator(seed, key), action);
                }
            }
            *step = step.wrapping_add(1);
        }
        actions
    }
}
