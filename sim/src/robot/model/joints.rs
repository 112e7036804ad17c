//! Joints of bodies.

use super::super::blueprint::{FreeJoint, Hinge, HingeAxis, JointPlan, LinkPlan, Motion, Planar};
use super::super::document::Element;
use super::super::frame::{Frame, IDENTITY, dot, rotated, vector};
use super::super::softness::Softness;
use super::bodies::Body;
use super::context::Context;

const KNOWN: [&str; 24] = [
    "name",
    "class",
    "type",
    "pos",
    "axis",
    "range",
    "limited",
    "stiffness",
    "springref",
    "springdamper",
    "damping",
    "armature",
    "frictionloss",
    "ref",
    "margin",
    "solreflimit",
    "solimplimit",
    "solreffriction",
    "solimpfriction",
    "actuatorfrcrange",
    "actuatorfrclimited",
    "actuatorgravcomp",
    // Without effect on the motion.
    "group",
    "user",
];
/// Shortest axis that has a direction.
const SHORTEST_AXIS: f64 = 1e-9;
const PASSIVE: [&str; 4] = ["stiffness", "damping", "armature", "frictionloss"];

/// All hinges and slides.
pub(super) fn hinges(links: &[LinkPlan]) -> Vec<&Hinge> {
    links.iter().filter_map(LinkPlan::hinge).collect()
}

/// Names of joints.
pub(super) fn names<'a>(joints: &[&'a Hinge]) -> impl Iterator<Item = &'a str> {
    joints.iter().map(|joint| joint.name.as_str())
}

/// Whether a joint is a free joint.
pub(super) fn is_free((joint, _): &(Element, Frame)) -> bool {
    joint.tag == "freejoint" || joint.text("type") == Some("free")
}

/// Name of a free joint; `None` for others.
pub(super) fn free_name(joint: &JointPlan) -> Option<&str> {
    match joint {
        JointPlan::Free(free) | JointPlan::Floating(free) => Some(&free.name),
        _ => None,
    }
}

/// Number of velocities of a joint.
pub(super) fn velocities(joint: &(Element, Frame)) -> usize {
    match joint.0.text("type") {
        _ if is_free(joint) => 6,
        Some("ball") => 3,
        _ => 1,
    }
}

/// Reads the joints of the root of a tree, the outermost first.
pub(super) fn read_root(body: &Body, context: &Context) -> Vec<JointPlan> {
    if let [joint] = body.joints.as_slice()
        && is_free(joint)
        && body.parent == 0
    {
        let free = context.blockers.keep(free(&joint.0, body, context));
        return free.into_iter().map(JointPlan::Free).collect();
    }
    match planar(body, context) {
        Ok(Some(planar)) => vec![JointPlan::Planar(planar)],
        _ => read(body, context),
    }
}

/// Reads the joints of any other body, the outermost first.
pub(super) fn read(body: &Body, context: &Context) -> Vec<JointPlan> {
    context.blockers.keep(check_order(body));
    let read = |(index, joint): (usize, &(Element, Frame))| {
        if is_free(joint) {
            let reason = "a free joint must be the only joint of a child of the world; remove it";
            return Err(joint.0.refuse(reason));
        }
        joint.0.only(&[&KNOWN])?;
        let name = match joint.0.text("name") {
            Some(name) => name.to_owned(),
            None if body.joints.len() == 1 => body.name.clone(),
            None => format!("{} joint {}", body.name, index + 1),
        };
        match joint.0.text("type") {
            Some("ball") => ball(&joint.0, &joint.1, name, context).map(JointPlan::Ball),
            _ => hinge(&joint.0, &joint.1, name, context).map(JointPlan::Hinge),
        }
    };
    let joints = body.joints.iter().enumerate();
    joints.filter_map(|joint| context.blockers.keep(read(joint))).collect()
}

fn check_order(body: &Body) -> Result<(), String> {
    let is_ball = |joint: &(Element, Frame)| joint.0.text("type") == Some("ball");
    let after = body.joints.iter().skip_while(|joint| !is_ball(joint)).skip(1);
    if after.into_iter().any(|(joint, _)| joint.text("type") != Some("slide")) {
        return Err(body.element.refuse("no hinge or ball may follow a ball joint; add a body"));
    }
    match body.joints.iter().map(velocities).sum::<usize>() {
        0..=6 => Ok(()),
        count => Err(body.element.refuse(format!(
            "its joints have {count} degrees of freedom, at most 6 are allowed; add a body"
        ))),
    }
}

fn free(joint: &Element, body: &Body, context: &Context) -> Result<FreeJoint, String> {
    if joint.tag == "freejoint" {
        joint.only(&[&["name", "group", "align"]])?;
        joint.flag("align")?;
    } else {
        joint.only(&[&KNOWN])?;
    }
    if joint.number("stiffness", 0.0)? != 0.0 || spring_damper(joint)?.is_some() {
        let reason =
            "`stiffness` of a free joint must be 0; use <freejoint/>, or set stiffness=\"0\" here";
        return Err(joint.refuse_for("stiffness", reason));
    }
    Ok(FreeJoint {
        name: joint.text("name").unwrap_or(&body.name).to_owned(),
        damping: number(joint, "damping")?,
        armature: number(joint, "armature")?,
        friction: context.friction(joint)?,
        friction_softness: softness(joint, ["solreffriction", "solimpfriction"], context)?,
    })
}

/// Number of an attribute; 0 without it.
pub(super) fn number(joint: &Element, name: &str) -> Result<f32, String> {
    joint.number(name, 0.0).map(|number| number as f32)
}

/// Joints along x and z and about y, on which nothing acts and which have no limits, as one joint.
fn planar(body: &Body, context: &Context) -> Result<Option<Planar>, String> {
    let [x, z, turn] = body.joints.as_slice() else { return Ok(None) };
    body.joints.iter().try_for_each(|(joint, _)| joint.only(&[&KNOWN]))?;
    let kinds =
        [("slide", [1.0, 0.0, 0.0]), ("slide", [0.0, 0.0, 1.0]), ("hinge", [0.0, 1.0, 0.0])];
    let (mut names, mut reference) = ([const { String::new() }; 3], [0.0; 3]);
    for (index, ((joint, frame), (kind, axis))) in [x, z, turn].into_iter().zip(kinds).enumerate() {
        let hinge = hinge(joint, frame, String::new(), context)?;
        let along = joint.numbers("axis")?.unwrap_or([0.0, 0.0, 1.0]);
        let plain = PASSIVE.iter().all(|name| matches!(joint.number(name, 0.0), Ok(0.0)));
        let placed = kind == "slide" || joint.numbers("pos")?.unwrap_or([0.0; 3]) == [0.0; 3];
        let same =
            joint.text("type").unwrap_or("hinge") == kind && along == axis && *frame == IDENTITY;
        let plain = plain && hinge.spring_damper.is_none() && !hinge.compensates_gravity;
        let is_driven = joint.text("name").is_some_and(|name| context.driven.contains(name));
        if !same || !plain || !placed || is_driven || hinge.range.is_some() {
            return Ok(None);
        }
        let unnamed = || format!("{} joint {}", body.name, index + 1);
        names[index] = joint.text("name").map_or_else(unnamed, str::to_owned);
        reference[index] = hinge.reference;
    }
    Ok(Some(Planar { names, reference }))
}

/// A ball joint. As in MuJoCo, its spring rests in the rest pose, and `ref`, `axis` and `actuatorfrcrange` have no effect.
fn ball(joint: &Element, frame: &Frame, name: String, context: &Context) -> Result<Hinge, String> {
    let ball = hinge(joint, frame, name, context)?;
    let range = ball.range.map(|ends| ends.map(|end| end + ball.reference));
    if range.is_some_and(|[low, _]| low != 0.0) {
        let reason =
            "the `range` of a ball joint must start at 0; set it to 0 and the largest angle";
        return Err(joint.refuse_for("range", reason));
    }
    Ok(Hinge { reference: 0.0, range, spring_rest: 0.0, torque_range: None, ..ball })
}

fn hinge(joint: &Element, frame: &Frame, name: String, context: &Context) -> Result<Hinge, String> {
    let motions =
        [("hinge", Motion::Rotation), ("slide", Motion::Translation), ("ball", Motion::Ball)];
    let motion = joint.word("type", &motions)?;
    let angle = |number: f64| match motion {
        Motion::Rotation | Motion::Ball => context.options.angles.radians(number),
        Motion::Translation => number,
    };
    let reference = angle(joint.number("ref", 0.0)?);
    let axis = joint.numbers("axis")?.filter(|_| motion != Motion::Ball);
    let axis = axis.unwrap_or([0.0, 0.0, 1.0]);
    if dot(axis, axis) < SHORTEST_AXIS * SHORTEST_AXIS {
        return Err(joint.refuse_for("axis", "`axis` has no direction; set one, such as 0 0 1"));
    }
    let anchor = joint.numbers("pos")?.unwrap_or([0.0; 3]);
    let (anchor, axis) = if *frame == IDENTITY {
        (anchor, axis)
    } else {
        (
            frame.then(&Frame { position: anchor, ..IDENTITY }).position,
            rotated(frame.rotation, axis),
        )
    };
    let range = context.limits(joint, |end| (angle(end) - reference) as f32)?;
    let margin = if range.is_some() { number(joint, "margin")? } else { 0.0 };
    let torque_range = context.range(joint, ["actuatorfrcrange", "actuatorfrclimited"])?;
    Ok(Hinge {
        name,
        anchor: vector(anchor),
        axis: HingeAxis::along(vector(axis)),
        motion,
        reference: reference as f32,
        range,
        margin,
        limit: softness(joint, ["solreflimit", "solimplimit"], context)?,
        stiffness: number(joint, "stiffness")?,
        spring_rest: (angle(joint.number("springref", 0.0)?) - reference) as f32,
        spring_damper: spring_damper(joint)?,
        damping: number(joint, "damping")?,
        armature: number(joint, "armature")?,
        friction: context.friction(joint)?,
        friction_softness: softness(joint, ["solreffriction", "solimpfriction"], context)?,
        torque_range: torque_range.map(|ends| ends.map(|end| end as f32)),
        compensates_gravity: joint.flag("actuatorgravcomp")? == Some(true),
    })
}

/// Softness of a constraint that two attributes state.
pub(super) fn softness(
    joint: &Element,
    [solref, solimp]: [&str; 2],
    context: &Context,
) -> Result<Softness, String> {
    let (reference, impedance) = Softness::DEFAULT;
    let reference = joint.padded(solref, reference)?;
    Softness::check(solref, reference).map_err(|reason| joint.refuse_for(solref, reason))?;
    let impedance = joint.padded(solimp, impedance)?;
    Ok(Softness::new(reference, impedance, context.options.timestep_secs))
}

fn spring_damper(joint: &Element) -> Result<Option<[f32; 2]>, String> {
    match joint.numbers("springdamper")?.map(|numbers| numbers.map(|number| number as f32)) {
        None | Some([0.0, 0.0]) => Ok(None),
        Some([time, ratio]) if time > 0.0 && ratio > 0.0 => Ok(Some([time, ratio])),
        Some(_) => {
            let reason = "`springdamper` must be a positive time constant and damping ratio";
            Err(joint.refuse_for("springdamper", reason))
        }
    }
}
