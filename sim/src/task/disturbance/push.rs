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

/// Cosine from which on an axis of the world is the normal of a plane, with its rounding.
const MOST_ALIGNED: f32 = 1.0 - 1e-6;

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
        let axes = row.axes.clone().unwrap_or_else(|| horizontal(robot, link));
        if axes.is_empty() {
            return Err(refused(format!(
                "{place}.axes is empty; write, for example, [\"x\", \"y\"]"
            )));
        }
        check_repeats(&format!("{place}.axes"), &axes)?;
        if let Some(across) = across(robot, link).filter(|across| axes.contains(across)) {
            let axis = if across == WorldAxis::X { "x" } else { "y" };
            let why = "along which a planar robot cannot move; remove it";
            return Err(refused(format!("{place}.axes has {axis}, {why}")));
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
                "{place}: duration_secs {secs} is less than half a step of {step} s; lengthen it"
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

/// The horizontal axis of the world that is the normal of the plane of a link's planar root, if any.
fn across(robot: &Robot, link: usize) -> Option<WorldAxis> {
    let root = &robot.blueprint.links[robot.blueprint.tree_of(link)];
    let normal = root.rest.rotation * Vector::Y;
    let is_planar = matches!(root.joint, JointPlan::Planar(_));
    let is_along = |axis: &WorldAxis| is_planar && normal[*axis as usize].abs() > MOST_ALIGNED;
    [WorldAxis::X, WorldAxis::Y].into_iter().find(is_along)
}

/// Horizontal axes of the world along which the tree of a link can move.
pub(super) fn horizontal(robot: &Robot, link: usize) -> Vec<WorldAxis> {
    match across(robot, link) {
        Some(WorldAxis::X) => vec![WorldAxis::Y],
        Some(_) => vec![WorldAxis::X],
        None => vec![WorldAxis::X, WorldAxis::Y],
    }
}

/// Horizontal axes of the world along which any tree can move.
pub(super) fn horizontal_of_all(robot: &Robot) -> Vec<WorldAxis> {
    let links = robot.blueprint.links.iter().enumerate();
    let moving = links.filter(|(_, plan)| !plan.is_base());
    let axes: Vec<WorldAxis> = moving.flat_map(|(link, _)| horizontal(robot, link)).collect();
    [WorldAxis::X, WorldAxis::Y].into_iter().filter(|axis| axes.contains(axis)).collect()
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
