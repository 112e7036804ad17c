//! The shapes of a robot and the agents that move them.

use sim::{EnvironmentBatch, LinkShape};

/// What stays the same from frame to frame.
pub(crate) struct RobotShapes {
    pub(super) shapes: Vec<LinkShape>,
    /// For each link of a pose, the agent that drives its joint.
    pub(super) drivers: Vec<Option<usize>>,
    pub(super) agents: usize,
}

impl RobotShapes {
    /// The shapes of a simulated robot; `None` for a game.
    pub(crate) fn of(world: &dyn EnvironmentBatch) -> Option<Self> {
        let description = world.description();
        let drivers = sim::drivers(description, &world.pose(0));
        Some(Self { shapes: world.robot()?.shapes(), drivers, agents: description.agents.len() })
    }
}
