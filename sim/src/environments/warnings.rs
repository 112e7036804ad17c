//! Warnings about a task that can be built but hardly be learnt: its motors, its floor, its start, and whom its reward
//! means.

use std::sync::Arc;

use crate::robot::{HingeMap, JointPlan, MotorPlan, Robot};
use crate::task::{Around, Rules};
use crate::world::World;

/// Depth of a start in another shape that is worth a warning, m.
const SMALLEST_DEPTH: f32 = 1e-3;
/// Distance of a start from a joint's limits that is worth a warning, rad or m.
const SMALLEST_EXCESS: f32 = 1e-3;
/// Narrower ranges of driven hinges suggest radians that were read as degrees.
const NARROWEST_RAD: f32 = 0.1;
/// Difference of an activation at the start from the control of action 0 that is worth a warning, as a share of the controls.
const LARGEST_DIFFERENCE: f32 = 0.01;
/// Most joints or shapes that a warning names.
const MOST_NAMED: usize = 6;

/// One sentence for each problem, with what to change.
///
/// `controls` are each motor's for the actions -1 and 1, in the order of the model's actuators.
pub(super) fn warnings(robot: &Arc<Robot>, rules: &Rules, controls: &[[f32; 2]]) -> Vec<String> {
    let (coordinates, velocities) = rules.start_pose(robot);
    let mut world = World::new(Arc::clone(robot));
    world.rebuild(&coordinates, &velocities);
    let mut warnings = robot.hard_to_explore(controls);
    warnings.extend(ambiguous_names(robot));
    warnings.extend(filters_away_from_start(robot, rules, controls));
    warnings.extend(angles(robot));
    warnings.extend(floor(robot));
    warnings.extend(overlaps(&world));
    warnings.extend(terrain(&world, robot, rules));
    warnings.extend(limits(robot, &coordinates));
    warnings.extend(unnamed(robot, rules));
    warnings.extend(unhealthy(robot, rules));
    if !rules.can_vary() {
        let why = "all episodes have the same return, so nothing is learnt but what terms of surprise and influence reward: add \
            a [[reward]] or [[cost]] with a weight, or [[healthy]] bounds for `alive`";
        warnings.push(why.to_owned());
    }
    warnings
}

/// Says which driven hinges have a range that suggests another unit of angles.
fn angles(robot: &Robot) -> Vec<String> {
    let is_narrow = |hinge: &HingeMap| {
        let is_narrow = |[low, high]: [f32; 2]| high - low < NARROWEST_RAD;
        hinge.units()[0] == "rad" && hinge.plan.range.is_some_and(is_narrow)
    };
    let about = |hinge: &HingeMap, is_wrong: fn(&HingeMap) -> bool| {
        let [low, high] = hinge.plan.range?;
        is_wrong(hinge).then(|| format!("`{}` {low:.3} to {high:.3} rad", hinge.plan.name))
    };
    let driven = |index: &usize| {
        robot.blueprint.motors.iter().any(|motor| motor.moved.only_hinge() == Some(*index))
    };
    let sentence = |is_wrong: fn(&HingeMap) -> bool, unit: &str| {
        let driven = (0..robot.layout.hinges.len()).filter(driven);
        let named = driven.filter_map(|index| about(&robot.layout.hinges[index], is_wrong));
        listed(&named.collect::<Vec<_>>()).map(|listed| {
            format!(
                "ranges of driven joints look like angles in another unit, {listed}: if they are in {unit}s, set `angle=\"{unit}\"` of \
                 the <compiler>"
            )
        })
    };
    let narrow = sentence(is_narrow, "radian");
    narrow.into_iter().chain(sentence(HingeMap::has_range_in_degrees, "degree")).collect()
}

/// Says which names in `agents` are those of one actuator and of the joint of another.
fn ambiguous_names(robot: &Robot) -> Option<String> {
    let motors = &robot.blueprint.motors;
    let of_other = |motor: &&MotorPlan| {
        let mut others = motors.iter().filter(|other| other.name != motor.name);
        motor.name != motor.joint && others.any(|other| other.joint == motor.name)
    };
    let named: Vec<String> =
        motors.iter().filter(of_other).map(|motor| format!("`{}`", motor.name)).collect();
    listed(&named).map(|listed| {
        format!(
            "names of actuators are also those of joints, tendons or sites of other actuators, {listed}: in `agents` such a name \
             stands for the actuators there; rename these actuators"
        )
    })
}

/// Says which filters start at an activation with which action 0 does not hold the start, though actions are around it.
fn filters_away_from_start(robot: &Robot, rules: &Rules, controls: &[[f32; 2]]) -> Option<String> {
    if rules.around == Around::Range {
        return None;
    }
    let motors = robot.blueprint.motors.iter().zip(controls);
    let mut starts = vec![0.0; robot.activations().count()];
    rules.start.set_activations(&mut starts);
    let filters = motors.filter(|(motor, _)| motor.activation.is_some()).zip(starts);
    let differs = |(motor, [low, high]): (&MotorPlan, &[f32; 2]), start: f32| {
        let middle = |[low, high]: [f32; 2]| low / 2.0 + high / 2.0;
        let [least, most] = motor.range;
        let held = middle([*low, *high]);
        let differs = (held - start).abs() > LARGEST_DIFFERENCE * (most - least);
        (!motor.integrates() && differs)
            .then(|| format!("`{}` at {start} instead of {held}", motor.name))
    };
    let named: Vec<String> = filters.filter_map(|(own, start)| differs(own, start)).collect();
    listed(&named).map(|listed| {
        format!(
            "action 0 does not hold the start at first, because filters start at another activation than its control, {listed}: \
             state `act` in a keyframe of the model and name it in [start] `keyframe`"
        )
    })
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

/// Says which conditions of the task the start does not meet.
fn unhealthy(robot: &Robot, rules: &Rules) -> Option<String> {
    listed(&rules.unhealthy_start(robot)).map(|listed| {
        format!(
            "the start does not meet {listed}, so episodes end in their first step: change the bounds, or [start] \
             `coordinates` or `keyframe`"
        )
    })
}

/// Says that a robot that can fall has no floor.
fn floor(robot: &Robot) -> Option<String> {
    let blueprint = &robot.blueprint;
    let falls = |joint: &JointPlan| {
        matches!(joint, JointPlan::Free(_) | JointPlan::Floating(_) | JointPlan::Planar(_))
    };
    // Fixed bodies of a model without a free joint.
    let mut bases = blueprint.links.iter().filter(|link| link.is_base());
    let has_base = bases.any(|link| link.shapes.iter().any(|shape| shape.surface.is_some()));
    let has_floor = has_base || !blueprint.grounds.is_empty();
    let flies = blueprint.motors.iter().any(|motor| motor.thrust.is_some());
    let is_bottomless =
        !has_floor && !flies && blueprint.links.iter().any(|link| falls(&link.joint));
    is_bottomless.then(|| {
        let why = "the robot has no floor that it can touch, so it falls: add <geom type=\"plane\" size=\"0 0 1\"/> \
            to the `worldbody`, or set `contype` and `conaffinity` of the floor and of shapes";
        why.to_owned()
    })
}

/// Says what starts inside the floor, and inside other fixed shapes, other robots and objects.
fn overlaps(world: &World) -> Vec<String> {
    let mut overlaps = world.overlaps();
    overlaps.retain(|_, depth| *depth > SMALLEST_DEPTH);
    let floors = overlaps.iter().filter(|((_, other), _)| other.is_none());
    let deepest = floors.max_by(|one, other| one.1.total_cmp(other.1));
    let floor = deepest.map(|((shape, _), depth)| {
        format!(
            "`{shape}` starts {depth:.3} m deep in the floor: raise it in [start], by `coordinates` or a `keyframe`"
        )
    });
    let inside = overlaps.iter().filter_map(|((shape, other), depth)| {
        let other = (*other)?;
        Some(format!("`{shape}` by {depth:.3} m in `{other}`"))
    });
    let inside = listed(&inside.collect::<Vec<_>>()).map(|listed| {
        format!(
            "what starts inside other shapes is pushed out, {listed}: set [start] `coordinates` or a `keyframe`"
        )
    });
    floor.into_iter().chain(inside).collect()
}

/// Says what starts inside the terrain where that is highest, deeper than at the heights of the model.
fn terrain(world: &World, robot: &Arc<Robot>, rules: &Rules) -> Option<String> {
    let conditions = rules.disturbance.highest_terrain()?;
    let (coordinates, velocities) = rules.start_pose(robot);
    let mut raised = World::new(Arc::clone(robot));
    raised.set_conditions(conditions);
    raised.rebuild(&coordinates, &velocities);
    let before = world.overlaps();
    let inside = raised.overlaps().into_iter().filter_map(|((shape, other), depth)| {
        let known = before.get(&(shape, other)).copied().unwrap_or(0.0);
        let other = other.filter(|_| depth - known.max(0.0) > SMALLEST_DEPTH)?;
        Some(format!("`{shape}` by {depth:.3} m in `{other}`"))
    });
    listed(&inside.collect::<Vec<_>>()).map(|listed| {
        format!(
            "at the largest heights of [[disturbance.terrain]], the start is inside other shapes, {listed}: lower `height`, \
             or raise the start by [start] `coordinates` or a `keyframe`"
        )
    })
}

/// The first of some names; `None` without any.
fn listed(names: &[String]) -> Option<String> {
    let more = if names.len() > MOST_NAMED { ", ..." } else { "" };
    let first = &names[..names.len().min(MOST_NAMED)];
    (!names.is_empty()).then(|| format!("{}{more}", first.join(", ")))
}

fn limits(robot: &Robot, coordinates: &[f32]) -> Option<String> {
    let hinges = robot.layout.hinges.iter().enumerate();
    let outside: Vec<String> = hinges
        .filter_map(|(index, hinge)| {
            let [low, high] = hinge.plan.range?;
            let at = coordinates[robot.layout.hinge_coordinate(index)];
            let excess = (low - at).max(at - high);
            let [unit, _] = hinge.units();
            (excess > SMALLEST_EXCESS)
                .then(|| format!("`{}` by {excess:.3} {unit}", hinge.plan.name))
        })
        .collect();
    let joints = match outside.len() {
        1 => "1 joint starts".to_owned(),
        count => format!("{count} joints start"),
    };
    listed(&outside).map(|listed| {
        format!("{joints} outside the limits, {listed}: set [start] `coordinates` or a `keyframe`")
    })
}
