//! Joint positions for the numbers in a robot's portrait.

use anyhow::Context as _;
use sim::{EnvironmentBatch, Outcome, Robot};

/// Joints closer than this hide each other's numbers, metres.
const APART: f32 = 0.08;
/// Limit of the steps that move legs apart.
const MOST_STEPS: usize = 30;

/// Steps the robot until at most one joint hides another, and returns the positions of all joints. Legs that are one
/// behind the other move apart; their hips stay in one place.
pub(crate) fn distinct_joints(world: &mut dyn EnvironmentBatch) -> anyhow::Result<Vec<[f32; 3]>> {
    let anchors = world.robot().map(Robot::hinge_positions).unwrap_or_default();
    let mut joints = places(world, &anchors);
    for _ in 0..MOST_STEPS {
        let hidden: Vec<bool> =
            (0..joints.len()).map(|index| hidden(&joints[index], &joints[..index])).collect();
        if hidden.iter().filter(|hidden| **hidden).count() <= 1 {
            break;
        }
        // Of two joints in one place the first turns one way, the second the other.
        let actions: Vec<f32> =
            hidden.iter().map(|hidden| if *hidden { -1.0 } else { 1.0 }).collect();
        world.step(&actions, &mut [Outcome::default()]).context("the robot cannot be moved")?;
        joints = places(world, &anchors);
    }
    Ok(joints)
}

/// Whether a joint is at the position of one of the others.
fn hidden(joint: &[f32; 3], others: &[[f32; 3]]) -> bool {
    let near = |other: &[f32; 3]| {
        let squares = joint.iter().zip(other).map(|(a, b)| (a - b) * (a - b));
        squares.sum::<f32>() < APART * APART
    };
    others.iter().any(near)
}

/// Positions of the joints that agents drive, in the order of their actions; `anchors` are their positions on their
/// links.
fn places(world: &dyn EnvironmentBatch, anchors: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let (task, pose) = (world.description(), world.pose(0));
    let links = &pose.links[pose.links.len() - anchors.len()..];
    let place = |name: &String| {
        let index = pose.joints.iter().position(|joint| joint.name == *name)?;
        Some(links[index].in_world(anchors[index]))
    };
    task.agents.iter().flat_map(|agent| &agent.joints).filter_map(place).collect()
}
