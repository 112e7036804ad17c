//! Sizes of the arrays of a chunk, from its slot and the description of its run.

use crate::{RolloutOrigin, RunDescription};

/// Sizes of one chunk of a slot, for a run with a validated description.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes<'a> {
    pub(crate) run: &'a RunDescription,
    pub(crate) steps: usize,
    pub(crate) environments: usize,
    pub(crate) agents: usize,
    pub(crate) state: usize,
}

impl<'a> Sizes<'a> {
    pub(crate) fn of(run: &'a RunDescription, origin: &RolloutOrigin) -> Self {
        Self {
            run,
            steps: run.chunk_steps as usize,
            environments: origin.environments.len(),
            agents: run.environment.agents.len(),
            state: run.environment.state.len(),
        }
    }

    pub(crate) fn observation(&self, agent: usize) -> usize {
        self.run.environment.agents[agent].observation.len()
    }

    pub(crate) fn action(&self, agent: usize) -> usize {
        self.run.environment.agents[agent].action.size
    }

    pub(crate) fn hidden(&self, agent: usize) -> usize {
        self.run.hidden_sizes[agent] as usize
    }

    pub(crate) fn stored(&self) -> usize {
        self.steps / self.run.hidden_every as usize
    }
}
