//! A whole episode of a trained policy in the simulator, for pictures, and its measures: its distance, and signs of a policy
//! that exploits weaknesses of the simulator.

use std::fmt;

use anyhow::Context as _;
use policy::{DrawKey, PolicySnapshot};
use proto::ActionChoice;
use rollout::{PlayedStep, StepEvent};
use sim::{EnvironmentBatch, Outcome, Pose, World};

use crate::errors::Usage;
use crate::film::{RobotShapes, TimedPose};

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
        world: &mut dyn EnvironmentBatch,
        policy: &PolicySnapshot,
        key: DrawKey,
    ) -> anyhow::Result<Self> {
        let is_game = || {
            Usage::new(format!("{} is a game: there is nothing to draw", world.description().task))
        };
        let mut robot = RobotShapes::of(world).ok_or_else(is_game)?;
        let dt_secs = world.description().dt_secs;
        let (mut moments, mut end) = (Vec::new(), Outcome::default());
        let start = (key, ActionChoice::Mean);
        let episode = rollout::play_episode(world, policy, start, |event| match event {
            StepEvent::Before(0, world) => {
                robot = RobotShapes::of(world).expect("it is no game");
                moments.push(Moment::of(world));
            }
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
    pub(crate) fn frame(&self, step: usize) -> TimedPose<'_> {
        TimedPose { time_secs: step as f64 * self.dt_secs, pose: &self.moments[step].pose }
    }

    /// One line with the return and the measures of the episode, and the reason of an early end.
    pub(crate) fn summary(&self) -> String {
        let end = match self.end {
            Outcome { fault: true, .. } => "; a physics fault ended it early",
            Outcome { terminated: true, .. } => "; the task's rules ended it early",
            _ => "",
        };
        let value = self.extrinsic_return;
        let steps = self.steps();
        let measures = Measures::of(&self.moments, self.dt_secs);
        format!("return {value:.2}, {steps} steps; {measures}{end}")
    }
}

/// Time after the start in which joints may move inside their limits, which frees energy.
const SETTLING_SECS: f64 = 0.5;

/// A robot after a step.
struct Moment {
    /// Where its links are.
    pose: Pose,
    /// Depth of the robots in what is fixed, metres; `None` if they touch nothing.
    depth: Option<f32>,
    /// Kinetic and potential energy, including springs, joules.
    energy: f64,
    /// Work of the actuators during the step, joules; `None` if some do not act on hinges and slides.
    work: Option<f64>,
}

impl Moment {
    /// The current state of environment 0.
    fn of(world: &dyn EnvironmentBatch) -> Self {
        let pose = world.pose(0);
        let world = robot(world);
        Self { pose, depth: world.depth_in_ground(), energy: world.mechanical_energy(), work: None }
    }

    /// After a step from `before`. The work of an actuator is its mean torque times the turn, which is exact for a motor, whose
    /// torque is constant within a step.
    fn after(step: &PlayedStep<'_>, before: &Self) -> Self {
        let now = Self::of(step.world);
        let turns = now.pose.joints.iter().zip(&before.pose.joints);
        let turns = turns.map(|(to, from)| to.position - from.position);
        let work = turns.zip(robot(step.world).efforts());
        let work = work.map(|(turn, effort)| f64::from(effort * turn));
        let is_known = robot(step.world).robot().drives_only_joints();
        Self { work: is_known.then(|| work.sum()), ..now }
    }

    /// Position of the root along x, metres.
    fn x(&self) -> f64 {
        f64::from(self.pose.root().position[0])
    }
}

/// The world of environment 0.
fn robot(world: &dyn EnvironmentBatch) -> &World {
    world.world(0).expect("only simulated robots are filmed")
}

/// Figures of one episode.
#[derive(Debug, PartialEq)]
struct Measures {
    /// Distance of the root along x, metres.
    distance: f64,
    secs: f64,
    /// Share of steps after which the robots touched nothing that is fixed.
    airborne: f64,
    /// Share of steps after which the root's upper side pointed down.
    upside_down: f64,
    /// Deepest penetration of what is fixed, metres.
    deepest: f64,
    /// Largest rise of energy in a step beyond the actuators' work, after the start, joules, if their work is known.
    created: Option<f64>,
}

impl Measures {
    /// `moments` begins with the start, which counts for the distance only, and has at least one step.
    fn of(moments: &[Moment], dt_secs: f64) -> Self {
        let start = &moments[0];
        let steps = &moments[1..];
        let settled = (SETTLING_SECS / dt_secs).ceil() as usize;
        let share = |what: &dyn Fn(&Moment) -> bool| {
            steps.iter().filter(|moment| what(moment)).count() as f64 / steps.len() as f64
        };
        Self {
            distance: moments[steps.len()].x() - start.x(),
            secs: steps.len() as f64 * dt_secs,
            airborne: share(&|moment| moment.depth.is_none_or(|depth| depth <= 0.0)),
            upside_down: share(&|moment| is_upside_down(&moment.pose)),
            deepest: steps.iter().filter_map(|moment| moment.depth).fold(0.0, f32::max).into(),
            created: risen(&moments[settled.min(steps.len())..]),
        }
    }
}

/// Whether the root's upper side points down.
fn is_upside_down(pose: &Pose) -> bool {
    sim::rotated(pose.root().quaternion, [0.0, 0.0, 1.0])[2] < 0.0
}

/// Largest rise of energy in one step beyond the actuators' work, joules; `None` if that is not known.
fn risen(moments: &[Moment]) -> Option<f64> {
    let mut pairs = moments.windows(2);
    let rise = |pair: &[Moment]| Some(pair[1].energy - pair[0].energy - pair[1].work?);
    pairs.try_fold(0.0, |most, pair| Some(f64::max(most, rise(pair)?)))
}

impl fmt::Display for Measures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { distance, secs, airborne, upside_down, deepest, created } = self;
        let speed = distance / secs;
        let millimetres = 1000.0 * deepest;
        let (airborne, upside_down) = (100.0 * airborne, 100.0 * upside_down);
        write!(f, "{distance:.2} m in {secs:.2} s, {speed:.2} m/s; in the air {airborne:.0} %, ")?;
        write!(f, "upside down {upside_down:.0} %, at most {millimetres:.1} mm in the floor")?;
        created.map_or(Ok(()), |joules| {
            write!(f, ", largest unexplained rise of energy {joules:.1} J in a step")
        })
    }
}

#[cfg(test)]
mod tests {
    use sim::LinkPose;

    use super::*;

    fn moment(x: f32, quaternion: [f32; 4], depth: Option<f32>) -> Moment {
        let (name, parent) = ("root".to_owned(), None);
        let root = LinkPose { name, parent, position: [x, 0.0, 1.0], quaternion };
        let pose = Pose { links: vec![root], ..Pose::default() };
        Moment { pose, depth, energy: f64::from(x), work: Some(0.75) }
    }

    #[test]
    fn the_figures_of_four_steps() {
        let (upright, over) = ([0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]);
        let moments = [
            moment(1.0, upright, None),
            moment(1.5, upright, Some(0.25)),
            moment(2.0, upright, Some(-0.1)),
            moment(3.0, over, Some(0.01)),
            moment(4.0, upright, Some(0.02)),
        ];
        let measures = Measures::of(&moments, 0.5);
        let (airborne, upside_down) = (0.25, 0.25);
        // Energy rises by half a joule, twice, and by a whole one, twice; the motors bring three quarters.
        let (deepest, created) = (0.25, Some(0.25));
        let by_hand =
            Measures { distance: 3.0, secs: 2.0, airborne, upside_down, deepest, created };
        assert_eq!(measures, by_hand);
        assert_eq!(
            measures.to_string(),
            "3.00 m in 2.00 s, 1.50 m/s; in the air 25 %, upside down 25 %, at most 250.0 mm in \
             the floor, largest unexplained rise of energy 0.2 J in a step"
        );
    }
}
