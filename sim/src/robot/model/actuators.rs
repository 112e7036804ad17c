//! Actuators: motors, and servos of the position or the speed of a joint.

use super::super::blueprint::{Hinge, LinkPlan, MotorPlan, Servo};
use super::super::document::{Element, check_names};
use super::context::Context;
use super::links::Links;

const KNOWN: [&str; 15] = [
    "name",
    "class",
    "joint",
    "jointinparent",
    "gear",
    "ctrlrange",
    "ctrllimited",
    "forcerange",
    "forcelimited",
    "kp",
    "kv",
    "inheritrange",
    "group",
    "user",
    "timeconst",
];
const GENERAL: [&str; 7] =
    ["gaintype", "biastype", "gainprm", "biasprm", "dyntype", "dynprm", "actlimited"];
/// Parameters of a gain or bias in a document.
const MOST_PARAMETERS: usize = 10;

/// Reads all actuators.
pub(super) fn read(
    root: &Element,
    context: &Context,
    links: &Links<'_>,
) -> Result<Vec<MotorPlan>, String> {
    let elements = || root.all("actuator").flat_map(|section| &section.children);
    check_names(elements())?;
    elements()
        .map(|element| {
            let element = context.classes.resolve(element, None)?;
            motor(&element, context, links)
        })
        .collect()
}

fn motor(element: &Element, context: &Context, links: &Links<'_>) -> Result<MotorPlan, String> {
    element.only(&[&KNOWN, &GENERAL])?;
    let joint = match (element.text("joint"), element.text("jointinparent")) {
        (Some(_), Some(_)) => return Err(element.refuse("it has `joint` and `jointinparent`")),
        (joint, in_parent) => joint.or(in_parent),
    };
    let joint = joint.ok_or_else(|| element.refuse("an actuator must act on a joint"))?;
    let hinges = links.plans.iter().filter_map(LinkPlan::hinge).enumerate();
    let found = hinges.into_iter().find(|(_, hinge)| hinge.name == joint);
    let (index, hinge) =
        found.ok_or_else(|| element.refuse(format!("no hinge or slide has the name `{joint}`")))?;
    let gear = element.padded("gear", [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])?[0];
    let force = force_range(element, context)?;
    let servo = servo(element, (hinge, gear), force)?;
    let range = control_range(element, hinge, context)?;
    Ok(MotorPlan {
        joint: joint.to_owned(),
        hinge: index,
        gear: gear as f32,
        range: range.map(|end| end as f32),
        servo,
    })
}

/// Range of the control. A policy needs one.
fn control_range(element: &Element, hinge: &Hinge, context: &Context) -> Result<[f64; 2], String> {
    let inherited = element.number("inheritrange", 0.0)?;
    let range = match hinge.range {
        Some([low, high]) if inherited > 0.0 => {
            let [low, high] = [low + hinge.reference, high + hinge.reference].map(f64::from);
            let (middle, half) = ((low + high) / 2.0, inherited * (high - low) / 2.0);
            Some([middle - half, middle + half])
        }
        _ => element.numbers("ctrlrange")?,
    };
    let limited = element.flag("ctrllimited")?;
    match range {
        Some([low, high])
            if low < high && limited.unwrap_or(context.options.autolimits || inherited > 0.0) =>
        {
            Ok([low, high])
        }
        Some([low, high]) if low >= high => {
            Err(element.refuse(format!("`ctrlrange` must ascend, is {low} to {high}")))
        }
        Some(_) => Err(element.refuse("its control must be limited: set `ctrllimited=\"true\"`")),
        None => Err(element.refuse("its control must be limited: set `ctrlrange`")),
    }
}

fn force_range(element: &Element, context: &Context) -> Result<Option<[f32; 2]>, String> {
    let range = element.numbers::<2>("forcerange")?;
    let limited = element.flag("forcelimited")?.unwrap_or(context.options.autolimits);
    match range.filter(|_| limited) {
        Some([low, high]) if low >= high => {
            Err(element.refuse("`forcerange` must have a lower and a higher end"))
        }
        range => Ok(range.map(|range| range.map(|end| end as f32))),
    }
}

/// Feedback of an actuator; `None` if its force is the control.
fn servo(
    element: &Element,
    (hinge, gear): (&Hinge, f64),
    range: Option<[f32; 2]>,
) -> Result<Option<Servo>, String> {
    let (gain, [constant, stiffness, slope]) = match element.tag.as_str() {
        "motor" => (1.0, [0.0; 3]),
        "position" => {
            only_without(element, "timeconst")?;
            let kp = element.number("kp", 1.0)?;
            (kp, [0.0, -kp, -element.number("kv", 0.0)?])
        }
        "velocity" => {
            let kv = element.number("kv", 1.0)?;
            (kv, [0.0, 0.0, -kv])
        }
        "general" => general(element)?,
        _ => return Err(element.refuse("this actuator is not supported")),
    };
    if gain == 1.0 && [constant, stiffness, slope] == [0.0; 3] && range.is_none() {
        return Ok(None);
    }
    let constant = constant + stiffness * gear * f64::from(hinge.reference);
    let bias = [constant, stiffness, slope].map(|number| number as f32);
    Ok(Some(Servo { gain: gain as f32, bias, range }))
}

fn only_without(element: &Element, name: &str) -> Result<(), String> {
    match element.number(name, 0.0)? {
        0.0 => Ok(()),
        _ => Err(element.refuse(format!("`{name}` is not supported"))),
    }
}

fn general(element: &Element) -> Result<(f64, [f64; 3]), String> {
    let word = |name, default| element.text(name).unwrap_or(default);
    if word("dyntype", "none") != "none" {
        return Err(element.refuse("actuators with an activation state are not supported"));
    }
    if word("gaintype", "fixed") != "fixed" {
        return Err(element.refuse("`gaintype` must be fixed"));
    }
    let mut one = [0.0; MOST_PARAMETERS];
    one[0] = 1.0;
    let gain = element.padded("gainprm", one)?[0];
    let [a, b, c, ..] = element.padded("biasprm", [0.0; MOST_PARAMETERS])?;
    match word("biastype", "none") {
        "none" => Ok((gain, [0.0; 3])),
        "affine" => Ok((gain, [a, b, c])),
        kind => Err(element.refuse(format!("biastype=\"{kind}\" is not supported"))),
    }
}
