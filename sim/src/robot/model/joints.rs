//! Joints of bodies.

use super::super::blueprint::{Hinge, HingeAxis, JointPlan, Motion, Planar};
use super::super::document::Element;
use super::super::frame::{Frame, IDENTITY, rotated, vector};
use super::super::softness::Softness;
use super::bodies::Body;
use super::context::Context;

const KNOWN: [&str; 19] = [
    "name",
    "class",
    "type",
    "pos",
    "axis",
    "range",
    "limited",
    "stiffness",
    "springref",
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
];
const SKIPPED: [&str; 3] = ["group", "user", "actuatorfrclimited"];
const PASSIVE: [&str; 4] = ["stiffness", "damping", "armature", "frictionloss"];

/// Whether a joint is a free joint.
pub(super) fn is_free((joint, _): &(Element, Frame)) -> bool {
    joint.tag == "freejoint" || joint.text("type") == Some("free")
}

/// Reads the joints of a child of the world, the outermost first.
pub(super) fn read_root(body: &Body, context: &Context) -> Result<Vec<JointPlan>, String> {
    for (joint, _) in &body.joints {
        check(joint)?;
    }
    if let [joint] = body.joints.as_slice()
        && is_free(joint)
    {
        let name = joint.0.text("name").unwrap_or(&body.name).to_owned();
        return Ok(vec![JointPlan::Free(name)]);
    }
    match planar(body, context)? {
        Some(planar) => Ok(vec![JointPlan::Planar(planar)]),
        None => read(body, context),
    }
}

/// Reads the joints of any other body, the outermost first.
pub(super) fn read(body: &Body, context: &Context) -> Result<Vec<JointPlan>, String> {
    for (joint, _) in &body.joints {
        check(joint)?;
    }
    if let Some((free, _)) = body.joints.iter().find(|joint| is_free(joint)) {
        return Err(free.refuse("a free joint must be the only joint of a child of the world"));
    }
    let hinge = |(index, joint): (usize, &(Element, Frame))| {
        let name = match joint.0.text("name") {
            Some(name) => name.to_owned(),
            None if body.joints.len() == 1 => body.name.clone(),
            None => format!("{} joint {}", body.name, index + 1),
        };
        hinge(&joint.0, &joint.1, name, context).map(JointPlan::Hinge)
    };
    body.joints.iter().enumerate().map(hinge).collect()
}

fn check(joint: &Element) -> Result<(), String> {
    if joint.tag == "freejoint" {
        return joint.only(&[&["name", "group", "align"]]);
    }
    joint.only(&[&KNOWN, &SKIPPED])?;
    match joint.text("type") {
        None | Some("hinge" | "slide") => Ok(()),
        Some("free") => no_passive_terms(joint),
        Some(kind) => Err(joint.refuse(format!("the type `{kind}` is not supported"))),
    }
}

fn no_passive_terms(joint: &Element) -> Result<(), String> {
    match PASSIVE.iter().find(|name| !matches!(joint.number(name, 0.0), Ok(0.0))) {
        Some(name) => Err(joint.refuse(format!("`{name}` of a free joint must be 0"))),
        None => Ok(()),
    }
}

/// Joints along x and z and about y, without forces and limits, as one joint.
fn planar(body: &Body, context: &Context) -> Result<Option<Planar>, String> {
    let [x, z, turn] = body.joints.as_slice() else { return Ok(None) };
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
        if !same || !plain || !placed || hinge.range.is_some() {
            return Ok(None);
        }
        names[index] = joint.text("name").unwrap_or("unnamed joint").to_owned();
        reference[index] = hinge.reference;
    }
    Ok(Some(Planar { names, reference }))
}

fn hinge(joint: &Element, frame: &Frame, name: String, context: &Context) -> Result<Hinge, String> {
    let motion = match joint.text("type") {
        Some("slide") => Motion::Translation,
        _ => Motion::Rotation,
    };
    let angle = |number: f64| match motion {
        Motion::Rotation => context.options.angles.radians(number),
        Motion::Translation => number,
    };
    let reference = angle(joint.number("ref", 0.0)?);
    let axis = joint.numbers("axis")?.unwrap_or([0.0, 0.0, 1.0]);
    if axis == [0.0; 3] {
        return Err(joint.refuse("`axis` has no direction"));
    }
    let anchor = joint.numbers("pos")?.unwrap_or([0.0; 3]);
    let (anchor, axis) = match *frame == IDENTITY {
        true => (anchor, axis),
        false => (
            frame.then(&Frame { position: anchor, ..IDENTITY }).position,
            rotated(frame.rotation, axis),
        ),
    };
    let stated = joint.numbers::<2>("range")?;
    let limited = joint.flag("limited")?;
    let limited = limited.unwrap_or(context.options.autolimits && stated.is_some());
    let range =
        stated.filter(|_| limited).map(|range| range.map(|end| (angle(end) - reference) as f32));
    if limited && range.is_none_or(|[low, high]| low >= high) {
        return Err(joint.refuse("`range` must have a lower and a higher end"));
    }
    if limited && joint.number("margin", 0.0)? < 0.0 {
        return Err(joint.refuse("`margin` must not be negative"));
    }
    let number = |name: &str| match joint.number(name, 0.0)? {
        number if number < 0.0 => Err(joint.refuse(format!("`{name}` must not be negative"))),
        number => Ok(number as f32),
    };
    Ok(Hinge {
        name,
        anchor: vector(anchor),
        axis: HingeAxis::along(vector(axis)),
        motion,
        reference: reference as f32,
        range,
        limit: softness(joint, ["solreflimit", "solimplimit"], context)?,
        stiffness: number("stiffness")?,
        spring_rest: (angle(joint.number("springref", 0.0)?) - reference) as f32,
        damping: number("damping")?,
        armature: number("armature")?,
        friction: number("frictionloss")?,
        friction_softness: softness(joint, ["solreffriction", "solimpfriction"], context)?,
        torque_range: torque_range(joint)?,
    })
}

fn softness(
    joint: &Element,
    [solref, solimp]: [&str; 2],
    context: &Context,
) -> Result<Softness, String> {
    let (reference, impedance) = Softness::DEFAULT;
    let reference = joint.padded(solref, reference)?;
    Softness::check(reference).map_err(|reason| joint.refuse(reason))?;
    let impedance = joint.padded(solimp, impedance)?;
    Ok(Softness::new(reference, impedance, context.options.timestep_secs))
}

fn torque_range(joint: &Element) -> Result<Option<[f32; 2]>, String> {
    let range = joint.numbers::<2>("actuatorfrcrange")?;
    if joint.flag("actuatorfrclimited")? == Some(false) {
        return Ok(None);
    }
    match range {
        Some([low, high]) if low > high => {
            Err(joint.refuse("`actuatorfrcrange` must have a lower and a higher end"))
        }
        range => Ok(range.map(|range| range.map(|end| end as f32))),
    }
}
