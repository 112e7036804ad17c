//! The agents' actions in the unit of the program that provides the environment.

use proto::{ActionSpec, EnvironmentSpec};
use sim::ActionScale;

/// The action of each agent.
#[derive(Clone, Debug)]
pub(super) struct OwnActions(Vec<OwnAction>);

#[derive(Clone, Copy, Debug)]
struct OwnAction {
    size: usize,
    /// `None` for a choice.
    scale: Option<ActionScale>,
}

impl OwnActions {
    /// The actions that the program describes.
    pub(super) fn of(offered: &EnvironmentSpec) -> Self {
        Self(offered.agents.iter().map(|agent| OwnAction::of(&agent.action)).collect())
    }

    /// Numbers of the joint action, `A`.
    pub(super) fn width(&self) -> usize {
        self.0.iter().map(|action| action.size).sum()
    }

    /// Splits `[n, A]`, in units of half a range, into `[n, act]` for each agent, in the program's units.
    pub(super) fn by_agent(&self, actions: &[f32]) -> Vec<Vec<f32>> {
        let width = self.width();
        let mut from = 0;
        let agent = |action: &OwnAction| {
            let columns = from..from + action.size;
            from += action.size;
            let own = |number: &f32| action.scale.map_or(*number, |scale| scale.apply(*number));
            actions.chunks_exact(width).flat_map(|row| &row[columns.clone()]).map(own).collect()
        };
        self.0.iter().map(agent).collect()
    }
}

impl OwnAction {
    fn of(offered: &ActionSpec) -> Self {
        let range = [offered.low, offered.high];
        let scale = offered.choices.is_none().then(|| ActionScale::to(range));
        Self { size: offered.size as usize, scale }
    }
}
