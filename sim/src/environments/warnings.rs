//! Warnings about a task that can be built but hardly be learnt: its motors, its floor, its start, and whom its reward
//! means.

use std::sync::Arc;

use crate::robot::{JointPlan, Robot};
use crate::task::Rules;
use crate::world::World;

/// Depth of a start in the floor that is worth a warning, m.
const SMALLEST_DEPTH: f32 = 1e-3;
/// Distance of a start from a joint's limits that is worth a warning, rad or m.
const SMALLEST_EXCESS: f32 = 1e-3;
/// Most joints that a warning names.
const MOST_NAMED: usize = 6;

/// One sentence for each problem, with what to change.
pub(super) fn warnings(robot: &Arc<Robot>, rules: &Rules) -> Vec<String> {
    let (coordinates, velocities) = rules.start_pose(robot);
    let mut world = World::new(Arc::clone(robot));
    world.rebuild(&coordinates, &velocities);
    let mut warnings = robot.hard_to_explore();
    warnings.extend(floor(robot, &world));
    warnings.extend(limits(robot, &coordinates));
    warnings.extend(unnamed(robot, rules));
    warnings
}

/// Says whose root is read if several robots have motors.
fn unnamed(robot: &Robot, rules: &Rules) -> Option<String> {
    let root = &robot.blueprint.links[robot.layout.root].name;
    let is_ambiguous = robot.driven_trees().len() > 1 && !rules.of_root.is_empty();
    is_ambiguous.then(|| {
        let readers = rules.of_root.join(", ");
        format!(
            "several robots have motors: {readers} read that of `{root}`; name a body by `of`, or a `coordinate`"
        )
    })
}

fn floor(robot: &Robot, world: &World) -> Option<String> {
    let blueprint = &robot.blueprint;
    let falls = |joint: &JointPlan| {
        matches!(joint, JointPlan::Free(_) | JointPlan::Floating(_) | JointPlan::Planar(_))
    };
    if !blueprint.links.iter().any(|link| falls(&link.joint)) {
        return None;
    }
    if blueprint.grounds.is_empty() {
        let why = "the robot has no floor that it can touch, so it falls: add <geom type=\"plane\" size=\"0 0 1\"/> \
            to the `worldbody`, or set `contype` and `conaffinity` of the floor and of shapes";
        return Some(why.to_owned());
    }
    let height = world.lowest_contact()?;
    (height < -SMALLEST_DEPTH).then(|| {
        format!(
            "the robot starts {:.3} m deep in the floor: raise it in [start], by `coordinates` or a `keyframe`",
            -height
        )
    })
}

fn limits(robot: &Robot, coordinates: &[f32]) -> Option<String> {
    let hinges = robot.layout.hinges.iter().enumerate();
    let outside: Vec<(f32, String)> = hinges
        .filter_map(|(index, hinge)| {
            let [low, high] = hinge.plan.range?;
            let at = coordinates[robot.layout.hinge_coordinate(index)];
            let excess = (low - at).max(at - high);
            let [unit, _] = hinge.units();
            (excess > SMALLEST_EXCESS)
                .then(|| (excess, format!("`{}` by {excess:.3} {unit}", hinge.plan.name)))
        })
        .collect();
    let count = outside.len();
    if count == 0 {
        return None;
    }
    let joints = if count == 1 { "1 joint starts" } else { &format!("{count} joints start") };
    let named: Vec<&str> =
        outside.iter().take(MOST_NAMED).map(|(_, named)| named.as_str()).collect();
    let more = if count > MOST_NAMED { ", ..." } else { "" };
    Some(format!(
        "{joints} outside the limits, {}{more}: set [start] `coordinates` or a `keyframe`",
        named.join(", ")
    ))
}
