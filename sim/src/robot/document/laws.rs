//! Laws of actuators: MuJoCo translates each kind to attributes of `general` as it reads it, also in a default class.

use super::Element;

/// Kinds of actuators, which share what is not their law in a default class.
pub(super) const KINDS: [&str; 9] = [
    "general",
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
];
/// Attributes of all kinds.
const COMMON: [&str; 18] = [
    "name",
    "class",
    "joint",
    "jointinparent",
    "tendon",
    "site",
    "refsite",
    "body",
    "cranksite",
    "slidersite",
    "gear",
    "ctrlrange",
    "ctrllimited",
    "forcerange",
    "forcelimited",
    "group",
    "user",
    // Of muscles, which are refused.
    "lengthrange",
];
/// Attributes of a law.
const GENERAL: [&str; 7] =
    ["gaintype", "biastype", "dyntype", "gainprm", "biasprm", "dynprm", "inheritrange"];
/// Further attributes of `general`.
const ACTIVATION: [&str; 3] = ["actlimited", "actrange", "actearly"];
/// Of `intvelocity`.
const INTEGRATED: [&str; 6] = ["kp", "kv", "dampratio", "inheritrange", "actrange", "actlimited"];
const POSITION: [&str; 5] = ["kp", "kv", "dampratio", "timeconst", "inheritrange"];

/// Law of an actuator, as attributes of `general`. `base` is the law of its kind in its class.
pub(super) fn law(element: &Element, base: &Element) -> Result<Element, String> {
    let (known, law): (&[&str], _) = match element.tag.as_str() {
        "general" => {
            element.only(&[&COMMON, &GENERAL, &ACTIVATION])?;
            let mut law = base.clone();
            let own =
                element.attributes.iter().filter(|(name, _)| GENERAL.contains(&name.as_str()));
            law.overlay(
                &element.with(own.map(|(name, text)| (name.clone(), text.clone())).collect()),
            );
            return Ok(law);
        }
        "motor" => (&[], Vec::new()),
        "velocity" => (&["kv"], velocity(element, base)?),
        "position" => (&POSITION, position(element, base)?),
        "intvelocity" => (&INTEGRATED, integrated(element, base)?),
        // It is refused where an actuator has it.
        kind => return Ok(element.with([("gaintype".to_owned(), kind.to_owned())].into())),
    };
    element.only(&[&COMMON, known])?;
    Ok(element.with(law.into_iter().map(|(name, text)| (name.to_owned(), text)).collect()))
}

/// Replaces attributes of an actuator by those of `top` that are not its law.
pub(super) fn overlay(actuator: &mut Element, top: &Element, law: &Element) {
    let is_law =
        |name: &&String| GENERAL.contains(&name.as_str()) || POSITION.contains(&name.as_str());
    let rest = top.attributes.iter().filter(|(name, _)| !is_law(name));
    actuator.overlay(&top.with(rest.map(|(name, text)| (name.clone(), text.clone())).collect()));
    if ["position", "intvelocity"].contains(&top.tag.as_str()) {
        actuator.attributes.remove("actearly");
    }
    if top.tag == "intvelocity" {
        actuator.attributes.remove("actlimited");
    }
    let inherits = top.text("inheritrange").is_some() && law.text("inheritrange").is_some();
    match top.tag.as_str() {
        "position" if inherits => actuator.attributes.remove("ctrlrange"),
        "intvelocity" if inherits => actuator.attributes.remove("actrange"),
        _ => None,
    };
}

type Law = Vec<(&'static str, String)>;

fn velocity(element: &Element, base: &Element) -> Result<Law, String> {
    let kv = element.number("kv", parameter(base, "gainprm", 0, 1.0)?)?;
    Ok(affine(kv, [0.0, 0.0, -kv]))
}

fn position(element: &Element, base: &Element) -> Result<Law, String> {
    let mut law = spring(element, base)?;
    let filtered = base.text("dyntype") == Some("filterexact");
    let filtered = if filtered { parameter(base, "dynprm", 0, 1.0)? } else { 0.0 };
    let time_constant_secs = element.number("timeconst", filtered)?;
    if time_constant_secs > 0.0 {
        law.push(("dyntype", "filterexact".to_owned()));
        law.push(("dynprm", time_constant_secs.to_string()));
    }
    law.extend(inherited(element, base, "ctrlrange")?);
    Ok(law)
}

/// A spring between the joint and a target, with its damping.
fn spring(element: &Element, base: &Element) -> Result<Law, String> {
    let kp = element.number("kp", parameter(base, "gainprm", 0, 1.0)?)?;
    let slope = match (element.numbers("kv")?, element.numbers("dampratio")?) {
        (Some([_]), Some([_])) => {
            let reason = "`dampratio` must not be stated with `kv`; remove one";
            return Err(element.refuse_for("dampratio", reason));
        }
        (Some([kv]), None) if kv < 0.0 => {
            return Err(element.refuse_for("kv", "`kv` must not be negative; change its sign"));
        }
        (Some([kv]), None) => -kv,
        // As in MuJoCo, a positive slope is a damping ratio.
        (None, Some([ratio])) => ratio,
        (None, None) => parameter(base, "biasprm", 2, 0.0)?,
    };
    Ok(affine(kp, [0.0, -kp, slope]))
}

/// `inheritrange`, by which the joint's or tendon's range gives the range `replaced`. An element that states `replaced` ignores the
/// `inheritrange` of its class; to state both is an error.
fn inherited(element: &Element, base: &Element, replaced: &str) -> Result<Law, String> {
    let has_range = element.text(replaced).is_some();
    let inherited = if has_range { 0.0 } else { base.number("inheritrange", 0.0)? };
    let inherited = element.number("inheritrange", inherited)?;
    if has_range && inherited > 0.0 {
        let reason = format!("`inheritrange` must not be stated with `{replaced}`; remove one");
        return Err(element.refuse_for("inheritrange", reason));
    }
    let law = (inherited > 0.0).then(|| ("inheritrange", inherited.to_string()));
    Ok(law.into_iter().collect())
}

/// A servo of the position whose control is the speed of its target.
fn integrated(element: &Element, base: &Element) -> Result<Law, String> {
    let mut law = spring(element, base)?;
    law.push(("dyntype", "integrator".to_owned()));
    law.extend(inherited(element, base, "actrange")?);
    Ok(law)
}

fn affine(gain: f64, bias: [f64; 3]) -> Law {
    let bias = bias.map(|number| number.to_string()).join(" ");
    vec![("gainprm", gain.to_string()), ("biastype", "affine".to_owned()), ("biasprm", bias)]
}

/// A number of a law's attribute.
fn parameter(law: &Element, name: &str, index: usize, default: f64) -> Result<f64, String> {
    let numbers = law.list(name)?.unwrap_or_default();
    Ok(numbers.get(index).copied().unwrap_or(default))
}
