//! A whole episode of a trained policy in the simulator, for pictures and measures.

use anyhow::Context as _;
use policy::{Key, PolicySnapshot};
use proto::ActionChoice;
use rollout::StepEvent;
use sim::{Outcome, TaskConfig};

use crate::errors::Usage;
use crate::film::measures::{Measures, Moment};
use crate::film::shapes::RobotShapes;
use crate::film::strip::Frame;

/// A whole episode.
pub(crate) struct PlayedEpisode {
    /// The robot.
    pub(crate) robot: RobotShapes,
    /// Duration of a step.
    pub(crate) dt_secs: f64,
    /// The start, then the state after every step.
    moments: Vec<Moment>,
    end: Outcome,
    extrinsic_return: f64,
}

impl PlayedEpisode {
    /// Plays the episode that starts with `key`, with mean actions; refuses a game, which has no robot.
    pub(crate) fn play(
        task: &TaskConfig,
        policy: &PolicySnapshot,
        key: Key,
    ) -> anyhow::Result<Self> {
        let mut world = sim::environments(task, 1).context("cannot build the task")?;
        let Some(robot) = RobotShapes::of(&*world) else {
            let why = format!("{} is a game: there is nothing to draw", task.task);
            return Err(Usage::new(why).into());
        };
        let dt_secs = world.description().dt_secs;
        let (mut moments, mut end) = (Vec::new(), Outcome::default());
        let start = (key, ActionChoice::Mean);
        let episode = rollout::play_episode(&mut *world, policy, start, |event| match event {
            StepEvent::Before(0, world) => moments.push(Moment::of(world)),
            StepEvent::Before(..) => {}
            StepEvent::After(step) => {
                let before = moments.last().expect("the start is there");
                let now = Moment::after(&step, before);
                moments.push(now);
                end = step.outcomes[0];
            }
        })
        .context("the episode failed")?;
        let extrinsic_return = episode.extrinsic_return;
        Ok(Self { robot, dt_secs, moments, end, extrinsic_return })
    }

    /// Number of steps.
    pub(crate) fn steps(&self) -> usize {
        self.moments.len() - 1
    }

    /// The pose after `step` steps.
    pub(crate) fn frame(&self, step: usize) -> Frame<'_> {
        Frame { time_secs: step as f64 * self.dt_secs, pose: &self.moments[step].pose }
    }

    /// One line with the return and the measures of the episode, and the reason of an early end.
    pub(crate) fn summary(&self) -> String {
        let end = match self.end {
            Outcome { fault: true, .. } => "; a physics fault ended it early",
            Outcome { terminated: true, .. } => "; the task's rules ended it early",
            _ => "",
        };
        let (value, steps) = (self.extrinsic_return, self.steps());
        let measures = Measures::of(&self.moments, self.dt_secs);
        format!("return {value:.2}, {steps} steps; {measures}{end}")
    }
}
