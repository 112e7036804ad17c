//! A team that acts by trained policies in a world that somebody else steps: recurrent states and draws, episode by
//! episode.

use std::sync::Arc;

use policy::{Draw, Purpose, RunSeed, Scratch, generator};
use proto::{ActStep, Acted, ActionChoice};

use crate::published::Published;

/// All agents of one world.
#[derive(Debug)]
pub(crate) struct Team {
    weights: Arc<Published>,
    choice: ActionChoice,
    /// Episodes before the present one.
    episodes: u64,
    members: Vec<Member>,
    scratch: Scratch,
}

/// What one agent remembers of its episode.
#[derive(Clone, Debug)]
struct Member {
    /// `[H]`
    hidden: Vec<f32>,
    /// Steps done.
    steps: u32,
}

impl Team {
    /// At the start of its first episode.
    pub(crate) fn new(weights: Arc<Published>, choice: ActionChoice) -> Self {
        let members = beginners(&weights);
        Self { weights, choice, episodes: 0, members, scratch: Scratch::default() }
    }

    /// An episode begins, by these weights: all recurrent states are zero. One that nobody has acted in counts for none.
    pub(crate) fn reset(&mut self, weights: Arc<Published>) {
        self.episodes += u64::from(self.members.iter().any(|member| member.steps > 0));
        self.members = beginners(&weights);
        self.weights = weights;
    }

    /// Actions for the observations of a step, which has been checked. Each row is computed by itself, so no agent's
    /// action depends on who else is asked, nor on other teams.
    pub(crate) fn act(&mut self, step: &ActStep) -> Acted {
        let rows = step.observations.iter();
        let actions = rows.map(|(agent, observation)| (*agent, self.action(*agent, observation)));
        Acted { actions: actions.collect(), weights: self.weights.name }
    }

    /// `[act]` for `[obs]`; the agent's recurrent state moves on by a step.
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

fn beginners(weights: &Published) -> Vec<Member> {
    let agents = weights.policy.agents.iter();
    agents.map(|agent| Member { hidden: vec![0.0; agent.hidden_size()], steps: 0 }).collect()
}
