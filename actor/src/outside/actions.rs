//! The agents' actions in the unit of the program that provides the environment.

use proto::{ActionSpec, AgentSpec, EnvironmentSpec};
use sim::in_range;

/// Numbers of the joint action, `A`.
pub(super) fn width(offered: &EnvironmentSpec) -> usize {
    offered.agents.iter().map(|agent| agent.action.size).sum()
}

/// Splits joint actions `[n, A]`, in units of half a range, into `[n, act]` for each agent, in the program's units.
pub(super) fn by_agent(offered: &EnvironmentSpec, actions: &[f32]) -> Vec<Vec<f32>> {
    let width = width(offered);
    let mut from = 0;
    let agent = |agent: &AgentSpec| {
        let ActionSpec { size, low, high, choices } = agent.action;
        let columns = from..from + size;
        from += size;
        let own = |number: &f32| match choices {
            None => in_range([low, high], *number),
            Some(_) => *number,
        };
        actions.chunks_exact(width).flat_map(|row| &row[columns.clone()]).map(own).collect()
    };
    offered.agents.iter().map(agent).collect()
}
