//! Pushes: forces on a link at drawn times.

use rand::RngCore;
use rapier3d::math::Vector;

use super::super::definition::{check_repeats, refused};
use super::super::relations::WorldAxis;
use super::row::PushRow;
use crate::error::SimError;
use crate::noise::{self, DrawPurpose, generator};
use crate::robot::{JointPlan, Robot};

/// Bits of a push's window in the index of its draw: above the longest episode, 1,000,000 steps.
const WINDOW_BITS: u32 = 20;

/// A push of a task.
#[derive(Clone, Debug)]
pub(super) struct Push {
    pub(super) link: usize,
    /// N.
    force: [f32; 2],
    /// Duration, steps.
    steps: u32,
    /// Length of a window, steps.
    period: u32,
    axes: Vec<WorldAxis>,
}

impl Push {
    /// Resolves a row.
    pub(super) fn new(row: &PushRow, link: usize, robot: &Robot) -> Result<Self, SimError> {
        let place = format!("disturbance.push ({})", row.link);
        let steps = |secs: f32| (f64::from(secs) / robot.step_secs()).round() as u32;
        let axes = row.axes.clone().unwrap_or_else(|| horizontal(robot));
        if axes.is_empty() {
            return Err(refused(format!(
                "{place}.axes is empty; write, for example, [\"x\", \"y\"]"
            )));
        }
        check_repeats(&format!("{place}.axes"), &axes)?;
        if is_planar(robot, link) && axes.contains(&WorldAxis::Y) {
            let why = "has y, along which a planar robot cannot move; remove it";
            return Err(refused(format!("{place}.axes {why}")));
        }
        let push = Self {
            link,
            force: row.force,
            steps: steps(row.duration_secs),
            period: steps(row.period_secs),
            axes,
        };
        if push.steps == 0 {
            let (secs, step) = (row.duration_secs, robot.step_secs());
            return Err(refused(format!(
                "{place}: duration_secs {secs} is less than half a step of {step} s"
            )));
        }
        if push.steps > push.period {
            return Err(refused(format!(
                "{place}: duration_secs {} must not exceed period_secs {}",
                row.duration_secs, row.period_secs
            )));
        }
        Ok(push)
    }

    /// Force in the step `step` of an episode, N. Each window of `period` steps has one push, which lies in it.
    pub(super) fn force(&self, key: [u8; 32], number: u32, step: u32) -> Vector {
        let (window, offset) = (step / self.period, step % self.period);
        let mut rng = generator(key, DrawPurpose::Push, (number << WINDOW_BITS) | window);
        let first = noise::whole(&mut rng, [0, self.period - self.steps]);
        if !(first..first + self.steps).contains(&offset) {
            return Vector::ZERO;
        }
        let size = noise::within(&mut rng, self.force);
        direction(&mut rng, &self.axes) * size
    }
}

/// Whether the tree of a link has a planar root.
fn is_planar(robot: &Robot, link: usize) -> bool {
    let root = robot.blueprint.tree_of(link);
    matches!(robot.blueprint.links[root].joint, JointPlan::Planar(_))
}

/// Horizontal axes along which the robot can move.
pub(super) fn horizontal(robot: &Robot) -> Vec<WorldAxis> {
    match is_planar(robot, robot.layout.root) {
        true => vec![WorldAxis::X],
        false => vec![WorldAxis::X, WorldAxis::Y],
    }
}

/// Draws a unit vector uniformly from the directions that the axes span.
pub(super) fn direction(rng: &mut impl RngCore, axes: &[WorldAxis]) -> Vector {
    let mut direction = Vector::ZERO;
    for axis in axes {
        direction[*axis as usize] = noise::normal(rng);
    }
    match direction.length() {
        0.0 => Vector::X,
        length => direction / length,
    }
}
