//! Computes the actions of all agents for an environment that a client steps: recurrent states and random draws.

use std::sync::Arc;

use policy::{Draw, Purpose, RunSeed, Scratch, generator};
use proto::{ActStep, Acted, ActionChoice};

use crate::lease::published::Published;

/// All agents of one environment.
#[derive(Debug)]
pub(crate) struct ServedAgents {
    weights: Arc<Published>,
    choice: ActionChoice,
    /// Episodes before the current one.
    episodes: u64,
    members: Vec<Member>,
    scratch: Scratch,
}

/// The state of one agent in the current episode.
#[derive(Clone, Debug)]
struct Member {
    /// `[H]`
    hidden: Vec<f32>,
    /// Finished steps of the episode.
    steps: u32,
}

impl ServedAgents {
    /// Agents at the start of their first episode.
    pub(crate) fn new(weights: Arc<Published>, choice: ActionChoice) -> Self {
        let members = initial_members(&weights);
        Self { weights, choice, episodes: 0, members, scratch: Scratch::default() }
    }

    /// Starts an episode with these weights; all recurrent states become zero. Episodes without a step are not counted.
    pub(crate) fn reset(&mut self, weights: Arc<Published>) {
        self.episodes += u64::from(self.members.iter().any(|member| member.steps > 0));
        self.members = initial_members(&weights);
        self.weights = weights;
    }

    /// Computes actions for the observations of a validated step. Rows are computed separately, so an action depends
    /// neither on the other agents in the step nor on those of other clients.
    pub(crate) fn act(&mut self, step: &ActStep) -> Acted {
        let rows = step.observations.iter();
        let actions = rows.map(|(agent, observation)| (*agent, self.action(*agent, observation)));
        Acted { actions: actions.collect(), weights: self.weights.name }
    }

    /// Computes an action `[act]` from an observation `[obs]` and advances the agent's recurrent state.
    fn action(&mut self, agent: usize, observation: &[f32]) -> Vec<f32> {
        let policy = &self.weights.policy.agents[agent];
        let member = &mut self.members[agent];
        let (mut output, mut action) =
            (vec![0.0; policy.output_size()], vec![0.0; policy.action_size()]);
        policy.forward(1, observation, &mut member.hidden, &mut output, &mut self.scratch);
        match self.choice {
            ActionChoice::Mean => policy.mode(&output, &mut action),
            ActionChoice::Sampled { seed } => {
                let key = Draw::of(Purpose::ServedAction)
                    .iteration(self.episodes)
                    .step(member.steps)
                    .agent(agent as u32);
                policy.draw(&output, &mut generator(RunSeed(seed), key), &mut action);
            }
        }
        member.steps = member.steps.wrapping_add(1);
        action
    }
}

fn initial_members(weights: &Published) -> Vec<Member> {
    let agents = weights.policy.agents.iter();
    agents.map(|agent| Member { hidden: vec![0.0; agent.hidden_size()], steps: 0 }).collect()
}
