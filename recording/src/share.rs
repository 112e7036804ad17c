//! A share: the logged steps of one episode in one lease.

use proto::trajectory_log::{AgentStep, Share, ShareEnd, Step};
use sim::Pose;

/// A complete share.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedShare {
    /// Episode and start state of the share.
    pub head: Share,
    /// Steps in order.
    pub steps: Vec<LoggedStep>,
    /// Final state and observations.
    pub end: ShareEnd,
}

/// A step of a share.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedStep {
    /// Pose of the robot before the step; empty for a game, and in a share that is read from a log.
    pub pose: Pose,
    /// Mean torques of the actuators during the step, N m, or forces on slides, N, for each joint of the pose.
    pub efforts: Vec<f32>,
    /// Observation and action of each agent, `[N]`.
    pub agents: Vec<AgentStep>,
    /// State before the step, and its result.
    pub step: Step,
}

impl LoggedShare {
    /// Episode step after the last step of the share.
    pub(crate) fn next_step(&self) -> u32 {
        self.head.first_step.saturating_add(self.steps.len() as u32)
    }
}
