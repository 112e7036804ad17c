//! The shapes of a robot and the agents that move them.

use sim::{Description, LinkShape, Pose};

/// What stays the same from frame to frame.
pub(crate) struct RobotShapes {
    pub(super) shapes: Vec<LinkShape>,
    /// For each link of a pose, the agent that drives its joint.
    pub(super) drivers: Vec<Option<usize>>,
    pub(super) agents: usize,
}

impl RobotShapes {
    /// The shapes of a robot; any of its poses gives the links that agents drive.
    pub(crate) fn new(description: &Description, shapes: Vec<LinkShape>, pose: &Pose) -> Self {
        let drivers = sim::drivers(description, pose);
        Self { shapes, drivers, agents: description.agents.len() }
    }
}
